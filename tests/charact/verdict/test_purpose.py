"""A session is fit for a purpose only with the frames that it needs; what lacks is named."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.special import erf

import charact
from charact.reporting.front_page import verdict
from charact.verdict.purpose import PURPOSES, lacks_of, purpose_of
from labdata import Result, load_camera, measurement_from_sd
from labdata.quantity import QUANTITIES

ROWS, COLS = 72, 96
FLATS, DARKS, EDGE = "flats of one gain setting at 3 levels or more", "darks of", "a slanted edge"


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A plain camera of its own make: gain K, read noise, black level and unequal pixels."""

    rng: np.random.Generator
    gain_dn_per_e: float
    black_dn: float = 50.0

    def stack(self, kind: str, electrons: object, frames: int = 6, **conditions: float):
        """Return a stack of frames of a mean image, electrons."""
        response = np.random.default_rng(1).normal(1.0, 0.01, (ROWS, COLS))
        mean = np.broadcast_to(np.asarray(electrons) * response, (frames, ROWS, COLS))
        charge = self.rng.poisson(mean) + self.rng.normal(0.0, 3.0, mean.shape)
        pixels = np.clip(np.round(self.gain_dn_per_e * charge + self.black_dn), 0, 4095)
        return charact.stack(pixels.astype(np.uint16), kind, exposure_s=0.01, **conditions)

    def flats(self, *levels: float, **conditions: float):
        """Return flats at levels, electrons."""
        return [self.stack("flat", level, **conditions) for level in levels]

    def edge(self, sigma_px: float = 0.9):
        """Return a slanted edge."""
        row, col = np.mgrid[:ROWS, :COLS]
        distance = col - COLS / 2 + 0.1 * (row - ROWS / 2)
        return self.stack("edge", 800 + 700 * erf(distance / (sigma_px * 2**0.5)))


def half_filled(bench: Bench) -> dict[str, tuple[list, tuple[str, ...]]]:
    """Return the stacks of sessions by name, and the frames that each must name."""
    darks, flats, edge = [bench.stack("dark", 0, 12)], bench.flats(300, 1200, 4000), [bench.edge()]
    others = Bench(rng=bench.rng, gain_dn_per_e=bench.gain_dn_per_e, black_dn=400.0)
    return {
        "darks alone": (darks, (FLATS, EDGE)),
        "flats alone": (flats, (DARKS, EDGE)),
        "one level": (darks + flats[:1] + edge, (FLATS,)),
        "two levels": (darks + flats[:2] + edge, (FLATS,)),
        "no target": (darks + flats, (EDGE,)),
        "no darks": (flats + edge, (DARKS,)),
        "saturated flats": (darks + bench.flats(9e4, 9e4, 9e4) + edge, ("flats of",)),
        "a target out of focus": ([*darks, *flats, bench.edge(9.0)], (EDGE + " in focus",)),
        "darks of another camera": ([others.stack("dark", 0), *flats, *edge], ("dark",)),
        "three gains": (
            darks + edge + [bench.flats(900.0, camera_gain_db=db)[0] for db in (0.0, 6.0, 12.0)],
            (FLATS,),
        ),
        "scene alone": ([bench.stack("point", 0.0)], ("point source",)),
    }


NAMES = tuple(half_filled(Bench(rng=np.random.default_rng(0), gain_dn_per_e=0.5)))


def answer(stacks: list):
    session = charact.session(stacks, bit_depth=12)
    return verdict(session, charact.measure(session, quick=True), None)


@pytest.mark.parametrize("name", NAMES)
def test_a_half_filled_session_is_never_fit_and_names_the_frames_to_add(name, seed):
    rng = np.random.default_rng(seed)
    stacks, words = half_filled(Bench(rng=rng, gain_dn_per_e=rng.uniform(0.3, 0.8)))[name]
    given = answer(stacks)
    assert given.status != "ok", given
    text = " ".join((given.heading, *given.reasons))
    assert all(word in text for word in words), text


def test_the_frames_that_lack_make_it_fit(seed):
    rng = np.random.default_rng(seed)
    bench = Bench(rng=rng, gain_dn_per_e=rng.uniform(0.3, 0.8))
    complete = [bench.stack("dark", 0, 12), *bench.flats(300, 1200, 4000), bench.edge()]
    given = answer(complete)
    assert given.status == "ok" and given.heading.startswith("Fit for a detector: all "), given
    assert given.line.startswith("✓ Fit for")
    assert answer([bench.edge()]).heading == ("Fit for the sharpness of a camera: its number is ok")


# The purpose is that of the frames; the rules alone, without frames that are measured.


def blank(kind: str, **conditions: float):
    return charact.stack(np.zeros((2, 9, 9)), kind, **conditions)


@pytest.mark.parametrize(
    ("kinds", "sensor", "name"),
    [
        (("edge",), None, "focus"),
        (("dark", "bars"), None, "focus"),
        (("dark", "point", "point"), None, "halo"),
        (("dark",), None, "detector"),
        (("dark", "flat", "edge"), None, "detector"),
        (("dark", "flat", "edge"), "machine-vision", "detector"),
        (("dark", "flat"), "gen3-digital-iccd", "tube"),
        (("flat", "edge"), "vox-lwir-640", "infrared"),
    ],
)
def test_the_purpose_of_a_session_is_that_of_its_frames(kinds, sensor, name):
    session = charact.session([blank(kind) for kind in kinds], sensor=sensor)
    is_tube = sensor is not None and load_camera(sensor).has_tube
    assert purpose_of(session, is_tube=is_tube) is PURPOSES[name]


def test_flats_of_known_photons_without_a_target_are_a_data_sheet():
    flats = [blank("flat", photons_per_px=level) for level in (10.0, 20.0, 30.0)]
    assert purpose_of(charact.session(flats), is_tube=False).name == "emva1288"
    assert purpose_of(charact.session([*flats, blank("edge")]), is_tube=False).name == "detector"


@pytest.mark.parametrize("name", PURPOSES)
def test_every_quantity_of_a_purpose_is_known_and_lacks_where_nothing_is_measured(name):
    purpose = PURPOSES[name]
    assert all(need.quantity in QUANTITIES for need in purpose.needs)
    lacks = lacks_of(charact.session([blank("scene")]), Result(), purpose)
    assert [lack.quantity for lack in lacks] == [need.quantity for need in purpose.needs]
    assert all(lack.frames and lack.reason for lack in lacks)


def test_most_curves_of_several_gains_decide():
    """One good curve beside two contradicting ones is no good number; one doubtful edge of four is
    the edge's.
    """
    good = measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, method="m")
    doubtful = good.with_(flags=("drift",))
    session = charact.session([blank("edge")])
    for measured, status in (((good, doubtful, doubtful), "refused"), ((good,) * 3, "ok")):
        assert verdict(session, Result(measurements=(*measured,)), None).status == status
    assert verdict(session, Result(measurements=(doubtful, *(good,) * 3)), None).status == "ok"
