"""The really measured files hold what the people who measured them say."""

import pytest

from torchplate.measurement import assess, place, read_measurement


def test_the_free_strip_shows_its_bending_and_torsion_peaks(real_file):
    measurement = read_measurement(real_file("free_strip.uff"))
    quality = assess(measurement)
    assert len(measurement.pairs) == 20
    assert [c.label for c in measurement.response] == ["1w", "5w"]
    assert [c.node for c in measurement.reference] == list(range(1, 11))
    assert (measurement.kind, quality.band, quality.step) == ("accelerance", (5.0, 500.0), 0.5)
    assert measurement.coherence is None
    for peak in (27.0, 53.0, 88.0, 131.5, 184.0, 245.5, 45.0):
        # The very lines that its README names.
        assert peak in quality.peaks
    assert [p.label for p in quality.driving_points] == ["1w/1w", "5w/5w"]
    assert [r.exchanged for r in quality.reciprocity] == ["5w/1w"]
    # Its phases cannot be trusted: a fifth of the driving-point power has the wrong sign.
    assert {s.label for s in quality.suspicions} == {"1w/1w", "5w/5w", "1w/5w"}


def test_the_free_strip_lies_on_its_centre_line(real_file):
    found = place(read_measurement(real_file("free_strip.uff")), 1.252, 0.165, 30, 4)
    assert found.by == "coordinate"
    assert found.reference[0].place == pytest.approx(((1.252 - 0.094) / 1.252, 0.5))
    assert found.reference[9].place == pytest.approx(((1.252 - 0.994) / 1.252, 0.5))
    # Half a step along x, and on a row of nodes.
    assert max(m.distance for m in found.reference) <= 0.5 * 1.252 / 30 + 1e-9


@pytest.mark.parametrize(
    ("name", "length", "width"), [("1L", 0.5798, 0.2134), ("3R", 0.5794, 0.2176), ("5L", 0.5814, 0.2176)]
)
def test_the_spruce_plates_have_coherence_and_corner_channels(name, length, width, real_file):
    measurement = read_measurement(real_file(f"spruce_{name}.uff"))
    quality = assess(measurement)
    assert (measurement.kind, quality.band, quality.step) == ("accelerance", (10.0, 1000.0), 0.5)
    assert measurement.reference[0].coordinate == pytest.approx((0.02, 0.02, 0.0))
    assert measurement.response[0].coordinate == pytest.approx((length - 0.02, width - 0.02, 0.0), abs=1e-6)
    (coherence,) = quality.coherence
    # An average of five hits on a plate indoors; found 0.9954, 0.9961 and 0.9964.
    assert 0.99 < coherence.mean < 1
    assert place(measurement, length, width, 20, 8).response[0].outside == 0


def test_the_cantilever_is_a_transmissibility_by_its_specifiers(real_file):
    measurement = read_measurement(real_file("cantilever_fe.uff"))
    quality = assess(measurement)
    assert (measurement.kind, measurement.unit) == ("transmissibility", "-")
    # 40–1200 Hz on lines of 0.488281 Hz, so the ends are the nearest lines.
    assert quality.band == pytest.approx((40.0, 1200.0), abs=0.488281)
    assert quality.step == pytest.approx(0.488281)
    assert [c.label for c in measurement.response] == ["2w"]
    # The fixture's feature near 663 Hz, between the plate's own first and second peak.
    assert quality.peaks == pytest.approx((139.2, 662.6, 903.3), abs=0.1)
    assert place(measurement, 0.0999, 0.02, 10, 2).response[0].place == pytest.approx((0.0959 / 0.0999, 0.0155 / 0.02))
