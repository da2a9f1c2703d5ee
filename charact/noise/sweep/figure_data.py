"""Figure data of a gain sweep: gain and read noise against the control, noise against signal at each setting."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.noise.sweep.joint import SweepJointFit
from charact.noise.sweep.knee import STATED_PE, Knee
from charact.noise.thresholds import SWEEP

Array = NDArray[np.float64]


def sweep_figure_data(joint: SweepJointFit, knee: Knee | None) -> dict[str, Any]:
    """Return gains and read noise against the control, the gain law with its interval, and the knee."""
    sweep, axis, law = joint.sweep, joint.axis, joint.law
    log_gains = np.array([s.log_gain for s in sweep.settings])
    x = np.linspace(-0.5, 0.5, SWEEP.figure_points)
    pulses = np.exp(law.posterior["log_gain"][:, None] + law.posterior["rise"][:, None] * x)
    low, middle, high = np.quantile(pulses + law.electron_gain_dn[:, None], [0.025, 0.5, 0.975], axis=0)
    left = np.exp(law.posterior["log_blur"]) if "log_blur" in law.posterior.names else np.ones(len(pulses))
    electrons = law.electron_gain_dn[:, None]
    stated = np.sqrt((electrons + left[:, None] * pulses) * (electrons + pulses) * STATED_PE)
    shrunk = np.quantile(law.settings, [0.025, 0.5, 0.975], axis=0)
    dark = [s.dark_variance_dn2 for s in sweep.settings]
    found: dict[str, Any] = {
        "figure": "noise-against-gain",
        "knob": sweep.knob.words,
        "knob_unit": sweep.knob.unit,
        "logarithmic": sweep.knob.logarithmic,
        "setting": [s.value for s in sweep.settings],
        "gain_dn": np.exp(log_gains[:, 0]).tolist(),
        "gain_relative_sd": log_gains[:, 1].tolist(),
        "joint_gain_dn": shrunk[1].tolist(),
        "joint_interval95_dn": shrunk[[0, 2]].tolist(),
        "blur_factor": [float(np.median(s.blur_factor)) for s in sweep.settings],
        "dark_noise_dn": [None if v is None else float(np.sqrt(max(v, 0.0))) for v in dark],
        "law_setting": sweep.knob.value(axis.middle + axis.span * x).tolist(),
        "law_gain_dn": middle.tolist(),
        "law_interval95_dn": [low.tolist(), high.tolist()],
        "departure_percent": 100.0 * float(np.median(np.exp(law.posterior["log_departure"]))),
        "stated_signal_pe": STATED_PE,
        "stated_noise_dn": np.quantile(stated, [0.025, 0.5, 0.975], axis=0).tolist(),
    }
    if knee is not None:
        places = np.quantile(knee.place, [0.025, 0.5, 0.975])
        found["read_noise_dn"] = float(np.median(knee.read_noise_dn))
        found["knee_gain_dn"] = float(np.median(knee.gain_dn))
        found["knee_setting"] = sweep.knob.value(axis.middle + axis.span * places).tolist()
    return found


def levels_figure_data(joint: SweepJointFit) -> dict[str, Any]:
    """Return noise of a pixel and signal over light at every level of every setting."""
    sweep, response = joint.sweep, joint.response
    found: dict[str, Any] = {
        "figure": "noise-by-gain",
        "knob": sweep.knob.words,
        "setting": [sweep.knob.text(s.value) for s in sweep.settings],
        "signal_dn": [s.signal_dn.tolist() for s in sweep.settings],
        "noise_dn": [
            np.sqrt(np.maximum(s.variance_dn2 + (s.dark_variance_dn2 or 0.0), 0.0)).tolist() for s in sweep.settings
        ],
        "dark_noise_dn": [
            None if s.dark_variance_dn2 is None else float(np.sqrt(max(s.dark_variance_dn2, 0.0)))
            for s in sweep.settings
        ],
        "light_unit": next((s.light_unit for s in sweep.settings if s.light is not None), ""),
        "light": [None if s.light is None else s.light.tolist() for s in sweep.settings],
    }
    if response is not None:
        found["lost_percent"] = 100.0 * float(np.median(response.posterior["lost"]))
        found["saturation_limit_dn"] = float(1.0 / max(np.quantile(response.lost_per_dn, 0.975), 1e-12))
    return found
