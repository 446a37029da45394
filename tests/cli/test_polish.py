"""`polish: true`: a population search finished by least squares."""

import pytest

SEARCHED = ["plate.youngs_modulus", "wires.stiffness", "loss.stiffness_loss_factor"]


def test_a_coarse_search_is_finished_at_the_truth(bench, truth):
    coarse = bench.run(SEARCHED, {"search.n_generation": 8}, out="coarse")
    polished = bench.run(SEARCHED, {"search.n_generation": 8, "search.polish": True}, out="polished")
    # The data are exact, so only the finish can come this near; the search alone is a thousand times as far.
    assert coarse.result["objective"] > 1e-3
    assert polished.result["objective"] < 1e-6
    for name in SEARCHED:
        assert polished.result["parameters"][name]["value"] == pytest.approx(truth[name], rel=1e-6)
    assert polished.result["n_evaluation"] > coarse.result["n_evaluation"]


def test_a_finish_that_does_not_lower_the_objective_is_not_taken(bench):
    # Least squares minimises another sum than log_amplitude; here nothing is left of either to lower.
    changes = {"search.n_generation": 4, "objective": {"kind": "log_amplitude"}, "measurement.gain": "unknown"}
    plain = bench.run(["plate.youngs_modulus"], changes, out="plain")
    polished = bench.run(["plate.youngs_modulus"], changes | {"search.polish": True}, out="polished")
    assert polished.result["objective"] <= plain.result["objective"]
