"""Figure data of a bar target."""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.bar_spectrum import BarShape, table_of
from charact.mtf.bars.forms import TUBE
from charact.mtf.bars.target import BarTarget
from charact.mtf.blur_models import transfer as forms
from labdata.frames import FrameStack

Array = NDArray[np.float64]

TUBE_EXPONENT = 1.2


def bar_profile(used: FrameStack, target: BarTarget, mtf: float) -> dict:
    """Return the mean profile across the bars and a model with the measured MTF, as figure data.

    The model has the tube transfer exp(-(f/fc)^1.2) with the measured value at the fundamental.
    """
    across, along = target.coordinates(used.shape[1:])
    mean = used.data.mean(axis=0, dtype=np.float64)
    near = (np.abs(along) < 0.3 * target.length_px) & (np.abs(across) < target.width_px / 2 + 1.5 / target.frequency)
    edges = np.arange(across[near].min(), across[near].max() + 0.25, max(0.25, 0.04 / target.frequency))
    place = np.digitize(across[near], edges)
    count = np.bincount(place, minlength=len(edges) + 1)[1:-1]
    filled = count > 0
    value = np.bincount(place, mean[near], minlength=len(edges) + 1)[1:-1][filled] / count[filled]
    distance = (0.5 * (edges[1:] + edges[:-1]))[filled]
    shape = _model_profile(distance, target, mtf)
    scale, level = np.polyfit(shape, value, 1) if shape.std() > 0 else (0.0, float(value.mean()))
    model = level + scale * shape
    return {
        "figure": "bars",
        "distance_px": distance.tolist(),
        "value_dn": value.tolist(),
        "model_dn": model.tolist(),
        "residual_dn": (value - model).tolist(),
        "frequency_cy_per_px": target.frequency,
        "mtf": mtf,
    }


def _model_profile(distance: Array, target: BarTarget, mtf: float) -> Array:
    """Return N blurred bars at distances from their centre, 1 on a wide bar."""
    frequency = target.frequency
    pixel = float(forms.aperture(np.array([frequency]), target.angle_rad)[0])
    core = float(np.clip(mtf / pixel, 1e-3, 0.999))
    shape = BarShape(
        bars=target.bars, frequency=frequency, length_px=np.inf, reference=frequency, form=TUBE,
        log_attenuation=float(np.log(-np.log(core))), form_one=float(np.log(TUBE_EXPONENT)), form_two=0.0,
        departure=0.0, angle_rad=target.angle_rad,
    )  # fmt: skip
    return table_of(shape, float(np.abs(distance).max()), 1.0).at(distance, distance)[0]
