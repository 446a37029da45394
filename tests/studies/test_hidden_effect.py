"""The study of a hidden magnet: where it writes."""

import pytest

from torchplate.studies import hidden_effect


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Run the study in an empty folder with nothing computed; what lies there afterwards."""
    monkeypatch.chdir(tmp_path)

    def diagnosed(config, out, **_):
        (out / "figures").mkdir(parents=True)
        for name in ("gap", "map"):
            (out / "figures" / f"{name}.png").write_text(name)

    monkeypatch.setattr(hidden_effect, "simulate", lambda *_, **__: None)
    monkeypatch.setattr(hidden_effect, "diagnose", diagnosed)

    def run(*given):
        assert hidden_effect.main(*given) == 0
        return {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.png")}

    return run


def test_no_committed_picture_is_written_over_unasked(written):
    figures = "runs/hidden_effect/diagnosis/figures"
    assert written() == {f"{figures}/gap.png", f"{figures}/map.png"}


def test_the_pictures_are_written_anew_where_that_is_asked_for(written, tmp_path):
    assert {"pictures/hidden_effect_gap.png", "pictures/hidden_effect_map.png"} <= written(tmp_path / "pictures")
    assert (tmp_path / "pictures" / "hidden_effect_map.png").read_text() == "map"
