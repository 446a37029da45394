"""Which effects are added: scored, refitted, compared, added and removed again.

- `forward`: forward selection with a beam of two: the baseline, then one effect after another; `steps`: one of these;
  `pairs`: two where one does not do; `worth`: whether what was added is worth going on beside it, and its name.
- `ranking`: the whole catalogue beside one model: scored, the best refitted; `shortlist`: which these are.
- `afar`: their way down where peaks need not overlap; `starts`: where refits begin; `refit`: of one of them;
  `details`: of the best with more numbers and with fewer; `instead`: what may be taken for the best of them;
  `grounded`: whether what is grounded is a support; `near`: how near the best a fit has to come to be followed;
  `attached`: what the catalogue has at a place that a force has found; `by_frequencies`: what natural frequencies say.
- `screen`: the score test over all candidates; `products`: its inner products, no change whitened; `null`: what chance
  alone would give in it.
- `criterion`: by what hypotheses are compared.
- `exchange`: exchange and backward elimination, once later effects are known.
- `settling`: the last model on a finer mesh, and beside the error of the given one.
- `trace`: what the selection has seen.
"""
