"""The blind benchmark: plates made by another discretisation, with something hidden in them, and a score.

`python tests/blind --set A --out runs/blind/A --workers 2` draws 160 cases, runs `torchplate diagnose` on each and
scores it. `--stratum workshop` and `--stratum tables` draw 200 others: FRFs of a plate and a test that are not perfect,
and natural frequencies alone.

Map:
    states: the suite of pairs of tests between which something changed, or nothing
    strata: clean, workshop, tables, shapes: how each is drawn
    splines: B-splines on 0 to 1 and their one-dimensional integrals
    ritz: the truth: Kirchhoff plates by an isogeometric Ritz method, their modes
    air: the added mass of the air, by equal panels
    response: FRFs from those modes, with dampers, windows and the sensor chain
    spectral: a second truth: the same plates by elements of high degree
    nuisances: what every test has and nobody wants named, and a plate with it
    noise: noise of several shapes
    beyond: what no effect of the catalogue describes
    plates: the two plates under test, and how they were tested
    effects: the hidden effects: ranges, draws, and what each does to the truth
    detect: whether a hidden effect shows in the FRFs once what the config searches is fitted
    fisher: how far it shows above noise and nuisances, by the truth's own information
    cases: the clean suite: which kind each case is, drawn by seed set and index
    workshop: the suite with all nuisances
    tables: the suite of natural frequencies
    real: the suite of what measured plates carry
    shapes: the suite of holes, ribs, turned grain and masses on springs
    twins: which names count as right
    place: what is right of places, sizes and moduli
    score: verdicts and tables
    suite: draws, runs and records, in worker processes
"""
