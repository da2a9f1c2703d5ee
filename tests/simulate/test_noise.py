"""Mean, variance and covariance of simulated flats agree with cascade theory (physics reference,
5.2, 6.4 and 10).
"""

from dataclasses import dataclass

import numpy as np
import pytest

from labdata import Conditions, Target
from simulate import LabBench
from simulate.camera import (
    PixelAperture,
    Slot,
    TubeShare,
    product,
    true_quantities,
)

LUX = 1e-4
FRAMES = 40


@dataclass(frozen=True)
class GaussianFibres:
    """The fibres of table 5.2, a Gaussian of 80 lp/mm at the photocathode."""

    def transfer(self, fx_per_mm, fy_per_mm):
        return np.exp(-(fx_per_mm**2 + fy_per_mm**2) / 80.0**2)


# Post-gain share; blur factor and correlation in the row for single rows (21.3 um), then for row
# pairs (42.5 um).
TABLE = [
    (1.0, 0.204, 0.45, 0.38, 0.282, 0.47, 0.18),
    (0.8, 0.250, 0.39, 0.33, 0.331, 0.41, 0.15),
    (0.5, 0.349, 0.29, 0.24, 0.434, 0.31, 0.11),
    (0.25, 0.482, 0.20, 0.17, 0.562, 0.21, 0.08),
    (0.0, 0.701, 0.11, 0.09, 0.762, 0.11, 0.04),
]


def _johnson(share: float) -> TubeShare:
    return TubeShare(share=share, frequency_lp_per_mm=26.25, exponent=1.184)


@pytest.mark.parametrize("row", TABLE)
def test_blur_factor_and_correlations_are_those_of_table_5_2(row):
    share, *published = row
    for height_mm, expected in ((0.0213, published[:3]), (0.0425, published[3:])):
        blurs = (
            _johnson(share),
            GaussianFibres(),
            PixelAperture(width_mm=0.018, height_mm=height_mm),
        )
        found = true_quantities.pulse_correlation(blurs, None, 0.018, height_mm)
        assert found[0] == pytest.approx(expected[0], abs=1.5e-3)
        assert found[1:] == pytest.approx(expected[1:], abs=6e-3)


@dataclass
class Flat:
    """Deviations of simulated frames from their known mean, and the truths."""

    deviations: np.ndarray
    mean: float
    quantities: dict[str, float]

    @property
    def signal(self) -> float:
        q = self.quantities
        return q["photoelectron_gain"] * (LUX * q["photoelectrons_per_lux"] + q["ebi_per_field"])

    def field(self, parity: int) -> np.ndarray:
        rows = 2 * (self.deviations.shape[1] // 2)
        return self.deviations[:, parity:rows:2]

    @property
    def variance(self) -> float:
        return float(np.mean(self.deviations**2)) - self.quantities["read_noise"] ** 2


def _flat(sensor, seed: int) -> Flat:
    bench = LabBench(sensor)
    conditions = Conditions(illuminance_lux=LUX)
    frames = bench.expose("flat", Target(), conditions, frames=FRAMES, seed=seed).data.astype(float)
    mean = bench.mean("flat", Target(), conditions).astype(float)
    return Flat(
        frames - mean, float(frames.mean()) - 400.0, true_quantities.true_quantities(sensor)
    )


@pytest.fixture(scope="module")
def glowing(plain, seed) -> Flat:
    return _flat(plain(120, 160), seed)


@pytest.fixture(scope="module")
def lagless(plain, seed) -> Flat:
    return _flat(plain(120, 160, phosphor__fast_decay_ms=1e-9, phosphor__slow_decay_ms=1e-9), seed)


def _with_error(per_frame: np.ndarray) -> tuple[float, float]:
    """Mean over frames and its standard error; blocks of four frames hold most of the glow's
    memory.
    """
    blocks = per_frame[: len(per_frame) // 4 * 4].reshape(-1, 4).mean(axis=1)
    return float(per_frame.mean()), float(blocks.std(ddof=1) / np.sqrt(len(blocks)))


def _block_variance(fields: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Variance of sums over blocks per pixel, for each frame: the covariance sum, short of what
    blocks cut off.
    """
    frames, height, width = fields.shape
    cut = fields[:, : height // rows * rows, : width // columns * columns]
    sums = cut.reshape(frames, height // rows, rows, width // columns, columns).sum(axis=(2, 4))
    return (sums**2).mean(axis=(1, 2)) / (rows * columns)


def _captured(sensor, rows: int, columns: int) -> float:
    """Share of the covariance sum that sums over blocks hold, by the same theory in the plane of
    frequencies.
    """
    from simulate.camera import CameraModel

    camera = CameraModel(sensor)
    # As many points as three times this on either axis tell the same to a millionth.
    x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in (400, 200))
    pitch_x, pitch_y = camera.cells.pitch_x_mm, 2 * camera.cells.pitch_y_mm
    power = np.zeros((len(y), len(x)))
    for m in (-2, -1, 0, 1, 2):
        for n in (-2, -1, 0, 1, 2):
            fx, fy = np.broadcast_arrays((x[None, :] + m) / pitch_x, (y[:, None] + n) / pitch_y)
            power += product(true_quantities._after_gain(camera), fx, fy) ** 2
    power *= np.abs(camera.stage(Slot.VIDEO).low_pass.transfer(x)) ** 2
    kernel = [
        (np.sin(np.pi * n * f) / np.sin(np.pi * f)) ** 2 / n for n, f in ((columns, x), (rows, y))
    ]
    return float(np.mean(power * kernel[0][None, :] * kernel[1][:, None]))


def test_mean_is_black_plus_gain_times_photoelectrons(lagless):
    mean, error = _with_error(lagless.deviations.mean(axis=(1, 2)))
    assert abs(mean) < 4.5 * error + 1e-3 * lagless.signal
    assert lagless.mean == pytest.approx(lagless.signal, rel=0.02)


@pytest.mark.parametrize("which", ["glowing", "lagless"])
def test_variance_is_blur_factor_times_covariance_gain_times_signal(which, request):
    flat: Flat = request.getfixturevalue(which)
    q = flat.quantities
    expected = q["blur_factor"] * q["field_covariance_gain"] * flat.signal
    mean, error = _with_error(
        (flat.deviations**2).mean(axis=(1, 2)) - q["read_noise"] ** 2 - 1.0 / 12.0
    )
    assert abs(mean - expected) < 4.5 * error + 0.003 * expected


@pytest.mark.parametrize("which", ["glowing", "lagless"])
def test_covariance_sum_of_a_field_is_its_truth(which, request, plain):
    flat: Flat = request.getfixturevalue(which)
    q = flat.quantities
    rows, columns = 10, 20
    captured = _captured(plain(120, 160), rows, columns)
    expected = captured * q["field_covariance_gain"] * flat.signal
    mean, error = _with_error(_block_variance(flat.field(0), rows, columns) - q["read_noise"] ** 2)
    assert abs(mean - expected) < 4.5 * error + 0.003 * expected


def test_without_decay_field_and_pulse_have_one_covariance_gain(lagless):
    q = lagless.quantities
    assert q["covariance_gain"] == pytest.approx(
        q["system_gain"] + q["photoelectron_gain"] * q["excess_noise_factor"]
    )
    assert q["field_covariance_gain"] == pytest.approx(q["covariance_gain"], rel=1e-3)
    assert q["field_correlation"] == pytest.approx(0.0, abs=1e-6)


def _correlation(flat: Flat, product: np.ndarray) -> tuple[float, float]:
    mean, error = _with_error(product.mean(axis=(1, 2)))
    return mean / flat.variance, error / flat.variance


def test_lines_of_one_field_correlate_as_their_blur_says(lagless):
    field = lagless.field(0)
    found, error = _correlation(lagless, field[:, 1:] * field[:, :-1])
    assert abs(found - lagless.quantities["correlation_vertical"]) < 4.5 * error + 0.003
