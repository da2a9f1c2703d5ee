"""Gain and blur of simulated specimens are found again; the simulator and the analysis share no
formula.
"""

from dataclasses import replace

import numpy as np

from charact.estimators import noise
from charact.method import Context
from labdata import Conditions, Session, Target, load_sensor
from simulate import LabBench
from simulate.camera import true_quantities
from simulate.virtual_bench import true_sensor
from tests.truth.sessions import session_in_memory, stack_in_memory

# A part of the chip: what is tested is independent of its size.
ROWS, COLUMNS = 246, 384
SETTINGS = Conditions(mcp_v=800.0, gate_ns=1.6e7)


def specimen(seed: int):
    """A camera drawn within the sheet's ranges, on a smaller chip."""
    drawn = true_sensor.draw_true_sensor(load_sensor("pulnix-ag5745ef3"), seed)
    return replace(drawn, ccd=replace(drawn.ccd, rows=ROWS, columns=COLUMNS))


def flats(sensor, seed: int) -> Session:
    bench = LabBench(sensor)
    stacks = []
    for index, lux in enumerate((0.0, 3e-5, 8e-5, 1.6e-4, 2.4e-4)):
        conditions = replace(SETTINGS, illuminance_lux=lux, illuminance_relative_sd=0.03)
        kind = "flat" if lux else "dark"
        held = bench.expose(kind, Target(), conditions, frames=12, seed=seed + index)
        stacks.append(stack_in_memory(kind, held, conditions, label=f"{kind}-{index}"))
    return session_in_memory(stacks, interlaced=True)


def test_covariance_gain_and_blur_factor_of_a_specimen_are_found_again(seed):
    sensor = specimen(seed)
    context = Context(
        seed=1,
        quick=True,
        camera=load_sensor("pulnix-ag5745ef3"),
        interlaced=True,
        full_scale_dn=255.0,
    )
    result = noise.measure(flats(sensor, 10 * seed), method="covariance-sum", context=context)
    known = true_quantities.true_quantities(sensor, SETTINGS)
    for quantity in ("covariance_gain", "blur_factor", "photoelectron_gain", "excess_noise_factor"):
        (found,) = result.find(quantity)
        low, high = found.interval68
        assert found.status == "ok", found
        assert abs(found.value - known[quantity]) < 4.5 * 0.5 * (high - low), (
            found,
            known[quantity],
        )
    (gain,) = result.find("covariance_gain")
    assert (gain.interval68[1] - gain.interval68[0]) / 2 < 0.05 * gain.value
    # The screen glows on: section 8, truth 20, has a correlation of .36 from field to field at the
    # sheet's decay.
    lags = result.evidence["autocorrelation"]["lag_correlation"]
    assert 0.2 < lags[0] < 0.55 and np.all(np.diff(lags[:4]) < 0)
