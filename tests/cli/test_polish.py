"""`polish: true`: a population search finished by least squares."""

import pytest

SEARCHED = ["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"]


@pytest.mark.check
def test_a_coarse_search_is_finished_at_the_truth(bench, truth):
    coarse = bench.run(SEARCHED, {"search.n_generation": 8}, out="coarse")
    polished = bench.run(SEARCHED, {"search.n_generation": 8, "search.polish": True}, out="polished")
    # The data are exact, so only the finish can come this near; the search alone is a thousand times as far.
    assert coarse.result["objective"] > 1e-3
    assert polished.result["objective"] < 1e-6
    for name in SEARCHED:
        assert polished.result["parameters"][name]["value"] == pytest.approx(truth[name], rel=1e-6)
    assert polished.result["n_evaluation"] > coarse.result["n_evaluation"]


@pytest.mark.check
def test_a_finish_that_raises_the_objective_is_not_taken(bench):
    # A plate too thin by 3 %, so that something is left to fit; least squares minimises another sum than the logarithm.
    changes = {"search.n_generation": 30, "objective": {"kind": "log_amplitude"}, "effects.plate.thickness": 0.003}
    searched = ["plate.youngs_modulus"]
    plain = bench.run(searched, changes, out="plain")
    polished = bench.run(searched, changes | {"search.polish": True}, out="polished")
    assert plain.result["objective"] > 1e-2
    # To what least squares may gain by rounding: taken all the same, the finish raises the objective by far more.
    assert polished.result["objective"] == pytest.approx(plain.result["objective"], rel=1e-9)
    value = [one.result["parameters"]["plate.youngs_modulus"]["value"] for one in (polished, plain)]
    assert value[0] == pytest.approx(value[1], rel=1e-6)
