"""What each verb does, in a file of the verb's name; `arguments` says what it takes on the command line.

From what was measured:

- `new`: a commented config; `new_draft`: what is guessed for it; `new_material`: of its material, by its resonances;
  `new_text`: its words.
- `inspect`: what a file holds, and what looks wrong in it.
- `frf`: from time records of hits to FRFs; `modes`: from FRFs to a modal model.

From a config, or the runs of one:

- `run`: a search of its intervals; `run_states`: over several tests of one plate at once.
- `diagnose`: the effect that is missing; `diagnose_change`: what has changed between tests.
- `plan`: what to measure next; `plan_text`: its words.
- `compare`: searches laid over each other.
- `simulate`: a virtual hammer test.

From nothing:

- `keys`: every key of a config; `effects`: the catalogue of effects.
- `bench`: what is fast, and beside what.
"""
