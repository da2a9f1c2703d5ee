"""Data sheets of EMVA 1288 of drawn frames whose truth is known."""

import numpy as np
import pytest
from scipy.ndimage import convolve
from scipy.stats import norm

import charact
from charact.estimators import noise
from charact.estimators.noise.nonuniformity import MeanFrame, highpass
from charact.method import Context
from charact.reporting import emva_summary
from labdata import Conditions, FrameStack
from labdata.data_sheet import BY_VARIANCE
from tests.truth.sessions import session_in_memory, stack_in_memory


@pytest.mark.parametrize("shape", [(60, 90), (240, 40)])
def test_rows_columns_and_pixels_are_separated(shape, seed):
    """The variances of columns, rows and pixels behind noise in time are those drawn (eq. 42)."""
    rng, frames, pixel_sd = np.random.default_rng(seed), 20, 0.7
    column, row = rng.normal(0.0, 1.0, (1, shape[1])), rng.normal(0.0, 2.0, (shape[0], 1))
    pixel = rng.normal(0.0, pixel_sd, shape)
    mean = 100.0 + row + column + pixel + rng.normal(0.0, 3.0, shape) / np.sqrt(frames)
    of_columns, of_rows = 9.0 / np.array(shape)
    frame = MeanFrame(dn=mean, frames=frames, pixel_dn2=9.0, column_dn2=of_columns, row_dn2=of_rows)
    square, sd, raised = frame.variances(filtered=False)
    assert np.all(np.abs(raised) < 1e-12)
    truth = np.array([column.var(), row.var(), pixel.var()])
    # Means of pixels over a column or row are a pattern of these too, by chance.
    shared = pixel_sd**2 / np.array([*shape, np.sqrt(pixel.size)])
    number = np.array([shape[1], shape[0], pixel.size])
    chance = np.sqrt((2.0 * shared**2 + 4.0 * truth * shared) / number)
    assert np.all(np.abs(square[1:] - truth) < 4.5 * np.hypot(sd[1:], chance))
    assert square[0] == pytest.approx(square[1:].sum())


@pytest.mark.parametrize(("row_sd", "flicker_sd"), [(1.5, 0.0), (0.0, 4.0)])
def test_rows_and_frames_that_move_in_time_stay_in_the_interval(row_sd, flicker_sd, seed):
    """The standard takes them for white: rows seem unequal, and flicker hides unequal pixels."""
    rng, shape, light = np.random.default_rng(seed), (64, 96), np.linspace(300.0, 6000.0, 8)
    unequal = rng.normal(0.0, 3.0, shape) + rng.normal(0.0, 1.0, (shape[0], 1))

    def frames(photons, count=4):
        moved = rng.normal(0.0, row_sd, (count, shape[0], 1))
        moved = moved + rng.normal(0.0, flicker_sd, (count, 1, 1))
        electrons = rng.poisson(photons, (count, *shape)) + rng.normal(0.0, 4.0, (count, *shape))
        return np.rint(100.0 + 0.5 * electrons + unequal + moved).astype(np.uint16)

    settings = {"photons_per_px": light, "exposure_s": 0.01, "bit_depth": 12, "quick": True}
    result = charact.noise(
        flats=[frames(p) for p in light], darks=[frames(0.0, 16)], seed=seed, **settings
    )
    # Rows beyond what their pixels make of them (eq. 42).
    of_lines = unequal.mean(axis=1).var() + unequal.mean(axis=0).var()
    pixel = (unequal.var() - of_lines) / (1.0 - 1.0 / shape[0] - 1.0 / shape[1])
    row = max(unequal.mean(axis=1).var() - pixel / shape[1], 0.0)
    for part, true in {"": unequal.std(), "_pixel": pixel**0.5, "_row": row**0.5}.items():
        (m,) = result.find(f"dsnu_1288{part}", unit="e-")
        low, high = m.interval95
        # Twice the standard error of a number of 95 %, for any seed.
        spread = 0.5 * (high - low) + 0.02 * m.value
        assert low - spread < true / 0.5 < high + spread, (part, m)


def test_the_filter_removes_shading_and_keeps_pixels(seed):
    pixels = np.random.default_rng(seed).normal(0.0, 1.0, (120, 160))
    across, down = np.meshgrid(np.linspace(-1, 1, 160), np.linspace(-1, 1, 120))
    left = highpass(pixels + 40.0 * (across**2 + down**2) + 25.0 * across)[12:-12, 12:-12]
    # 1 - 2 h(0) + sum h^2 of the smooth part h, which is 1/121 in its middle.
    assert left.var() == pytest.approx(0.989 * pixels.var(), rel=0.03)
    # A wave of f cycles per pixel keeps 1 - H of boxes of 7 and 11 pixels and cos^2(pi f).
    frequency = 0.05
    boxes = [np.sin(np.pi * n * frequency) / (n * np.sin(np.pi * frequency)) for n in (7, 11)]
    wave = np.cos(2.0 * np.pi * frequency * np.arange(160)) * np.ones((120, 1))
    passed = 1.0 - np.prod(boxes) * np.cos(np.pi * frequency) ** 2
    assert highpass(wave)[60, 40:120] == pytest.approx(passed * wave[60, 40:120], abs=1e-9)


def test_saturation_is_where_one_pixel_of_a_thousand_is_full(seed):
    """Pixels of shot noise s are full at 4095 DN: 0.1 % of them at the level 4094.5 DN - 3.09 s."""
    rng, photons = np.random.default_rng(seed), np.linspace(400.0, 4400.0, 21)
    flats = [
        np.minimum(rng.poisson(light, (4, 80, 120)) + 50, 4095).astype(np.uint16)
        for light in photons
    ]
    dark = np.rint(50.0 + rng.normal(0.0, 2.0, (4, 80, 120))).astype(np.uint16)
    settings = {"photons_per_px": photons, "exposure_s": 0.01, "bit_depth": 12, "quick": True}
    result = charact.noise(flats=flats, darks=[dark], seed=seed, **settings)
    light = np.linspace(3500.0, 4400.0, 9001)
    full = norm.sf((4094.5 - 50.0 - light) / np.sqrt(light))
    truth = float(np.interp(0.001, full, light))
    (exposure,) = result.find("saturation_exposure_full_scale")
    assert exposure.interval95[0] < truth < exposure.interval95[1]
    # A tenth of a step of the levels; 1 % of full pixels are at a quarter of it more.
    assert exposure.value == pytest.approx(truth, abs=20.0)
    (capacity,) = result.find("saturation_capacity_full_scale")
    assert capacity.value == pytest.approx(truth, rel=0.03)


def test_the_gain_of_the_standard_stands_beside_that_of_diffusing_charge(seed):
    """Of charge that leaves its pixel the slope of the variance is K times the kernel's energy."""
    rng, photons = np.random.default_rng(seed), np.linspace(500.0, 6000.0, 6)
    kernel = np.array([[0.0, 0.04, 0.0], [0.04, 0.84, 0.04], [0.0, 0.04, 0.0]])

    def frames(light):
        electrons = rng.poisson(0.6 * light, (8, 128, 160)).astype(float)
        blurred = convolve(electrons, kernel[None], mode="wrap")
        return np.rint(100.0 + 0.5 * blurred + rng.normal(0.0, 2.0, blurred.shape)).astype("u2")

    settings = {"photons_per_px": photons, "exposure_s": 0.01, "bit_depth": 12, "quick": True}
    result = charact.noise(
        flats=[frames(light) for light in photons], darks=[frames(0.0)], seed=seed, **settings
    )
    energy = float((kernel**2).sum())
    rows = {row.entry.element[1]: row for row in emva_summary(result)["rows"]}
    gain, efficiency = rows["K"], rows["QE"]
    assert gain.flags == ("correlated-noise",)
    assert gain.m.value == pytest.approx(0.5 * energy, rel=0.01)
    low, high = efficiency.m.interval95
    assert low < 60.0 < high
    beside = float(efficiency.entry.remark.removeprefix(BY_VARIANCE).split()[0])
    assert beside == pytest.approx(60.0 / energy, rel=0.02)


SHAPE, GAIN, EFFICIENCY, READ_E, CURRENT_E_PER_S = (96, 128), 0.4, 0.5, 6.0, 300.0
# Parts of columns, rows and pixels.
DARK_E, RESPONSE = (3.0, 2.0, 4.0), (0.004, 0.006, 0.012)


def pattern(parts, seed):
    """Unequal columns, rows and pixels, each of mean 0 over the others."""
    rng = np.random.default_rng(seed)
    shapes = ((1, SHAPE[1]), (SHAPE[0], 1), SHAPE)
    column, row, pixel = (rng.normal(0.0, sd, size) for sd, size in zip(parts, shapes, strict=True))
    pixel -= pixel.mean(axis=0) + pixel.mean(axis=1, keepdims=True)
    return column - column.mean() + row - row.mean() + pixel


def drawn(rng, kind, label, count, light=0.0, exposure_s=0.01, temperature_c=25.0):
    """Frames of a linear camera of 12 bits."""
    thermal = CURRENT_E_PER_S * 2.0 ** ((temperature_c - 25.0) / 7.0) * exposure_s
    mean = EFFICIENCY * light * (1.0 + pattern(RESPONSE, 1)) + thermal
    electrons = rng.poisson(mean, (count, *SHAPE)) + rng.normal(0.0, READ_E, (count, *SHAPE))
    values = np.rint(100.0 + GAIN * (electrons + pattern(DARK_E, 2)))
    conditions = Conditions(
        photons_per_px=light if kind == "flat" else None,
        exposure_s=exposure_s,
        temperature_c=temperature_c,
    )
    frames = FrameStack(data=np.clip(values, 0, 4095).astype(np.uint16), full_scale_dn=4095.0)
    return stack_in_memory(kind, frames, conditions, label=label)


@pytest.fixture(scope="module")
def stacks():
    """All that the standard asks for: 50 levels, 16 frames, six exposures, two temperatures."""
    rng, light = np.random.default_rng(12), np.linspace(420.0, 21000.0, 50)
    flats = [drawn(rng, "flat", f"flat-{i}", 2, light=p) for i, p in enumerate(light)]
    darks = [
        drawn(rng, "dark", f"dark-{t}-{warm}", 2, exposure_s=t, temperature_c=warm)
        for warm in (25.0, 32.0)
        for t in (0.01, 0.6, 1.2, 1.8, 2.4, 3.0)
    ]
    spatial = drawn(rng, "flat", "half", 16, light=10000.0), drawn(rng, "dark", "black", 16)
    return [*flats, *darks, *spatial]


def rows_of(stacks):
    session = session_in_memory(stacks, bit_depth=12)
    context = Context(seed=1, quick=True, full_scale_dn=4095.0)
    result = noise.measure(session, method="variance", context=context)
    return {"/".join(row.entry.element): row for row in emva_summary(result)["rows"]}


def test_a_complete_session_is_to_the_standard_in_every_row_and_true(stacks):
    rows = rows_of(stacks)
    assert {name: row.departure for name, row in rows.items() if row.departure} == {}
    assert {name: row.flags for name, row in rows.items() if row.status != "ok"} == {}
    truth = {
        "sensitivity/QE": 100.0 * EFFICIENCY,
        "sensitivity/K": GAIN,
        "sensitivity/R": GAIN * EFFICIENCY,
        "sensitivity/sigma_d": READ_E,
        "dark_current/u_I_mean": CURRENT_E_PER_S,
        "dark_current/u_I_var": CURRENT_E_PER_S,
        "dark_current/T_d": 7.0,
    }
    for part, axis in (("row", 1), ("col", 0)):
        lines = pattern(DARK_E, 2).mean(axis=axis), pattern(RESPONSE, 1).mean(axis=axis)
        truth[f"spatial/DSNU1288_{part}"] = lines[0].std()
        truth[f"spatial/PRNU1288_{part}"] = 100.0 * lines[1].std()
    for name, true in truth.items():
        low, high = rows[name].m.interval95
        half = max(high - rows[name].m.value, rows[name].m.value - low)
        assert abs(rows[name].m.value - true) < 4.5 / 1.96 * half + 0.01 * true, name
        assert half < 0.4 * true, name


def test_values_in_steps_of_16_have_the_same_sheet_but_for_their_unit(stacks):
    """A camera of 12 bits that writes 16 shifts its values."""
    few = [stack for stack in stacks if not stack.label.startswith("dark-")]
    shifted = [
        stack_in_memory(
            stack.kind,
            FrameStack(data=stack.kept.data * np.uint16(16), full_scale_dn=65520.0),
            stack.conditions,
            label=stack.label,
        )
        for stack in few
    ]
    plain, coarse = (
        noise.measure(
            session_in_memory(of, bit_depth=16),
            method="variance",
            context=Context(seed=1, quick=True, full_scale_dn=full),
        )
        for of, full in ((few, 4095.0), (shifted, 65520.0))
    )
    for name, unit, factor in (
        ("dsnu_1288_row", "e-", 1.0),
        ("dsnu_1288", "DN", 16.0),
        ("prnu_1288_filtered", "%", 1.0),
        ("linearity_error", "%", 1.0),
        ("saturation_capacity_full_scale", "e-", 1.0),
    ):
        values = [result.find(name, unit=unit)[0].value for result in (plain, coarse)]
        assert values[1] == pytest.approx(factor * values[0], rel=1e-3), name
    figures = [result.evidence["defect-histograms"] for result in (plain, coarse)]
    assert figures[0]["pixels_of_dsnu"] == figures[1]["pixels_of_dsnu"]
    assert sum(figures[1]["pixels_of_dsnu"]) == SHAPE[0] * SHAPE[1]
    assert figures[1]["deviation_dn"][0] == pytest.approx(16.0 * figures[0]["deviation_dn"][0])


@pytest.mark.parametrize(
    ("kept", "names", "words"),
    [
        (lambda s: s.label not in ("half", "black"), ["spatial/PRNU1288"], "stacks of 16 frames"),
        (
            lambda s: not s.label.startswith("flat") or int(s.label[5:]) % 2,
            ["sensitivity/K", "linearity/LE"],
            "25 more levels",
        ),
        (lambda s: "32" not in s.label, ["dark_current/T_d"], "two temperatures"),
        (lambda s: "1." not in s.label, ["dark_current/u_I_mean"], "more exposures"),
        (
            lambda s: (s.conditions.photons_per_px or 0.0) < 15000.0,
            ["sensitivity/SNR_max", "sensitivity/u_e_sat_full_scale"],
            "",
        ),
    ],
)
def test_what_a_session_lacks_stands_in_the_rows_that_need_it(stacks, kept, names, words):
    rows = rows_of([stack for stack in stacks if kept(stack)])
    for name in names:
        assert rows[name].departure and words in rows[name].departure
