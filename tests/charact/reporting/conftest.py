"""A session, a result and truths made up for the report's tests; no camera and no method behind
them.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from labdata import (
    Conditions,
    Curve,
    FrameStack,
    Posterior,
    Provenance,
    Result,
    Session,
    StackEntry,
    Target,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
)
from tests.truth.sessions import session_in_memory, stack_in_memory

HOSTILE = '<script>alert("edge")</script>'
REASON = "a halo needs a point source, and the session holds none"
WIRES = "The camera ran in this process: its wire was left out."
NOTE = "Noise is correlated and was treated as such."
DIGEST = "ab" * 32


def held(label: str, kind, data: np.ndarray, **fields) -> StackEntry:
    """A stack in memory."""
    return stack_in_memory(kind, FrameStack(data=data), label=label, **fields)


def session(name: str = "day 1") -> Session:
    """Darks, flats and an edge of 120 by 160 pixels."""
    rng = np.random.default_rng(3)
    flat = rng.normal(100, 12, (2, 120, 160)).clip(0, 255).astype(np.uint8)
    conditions = Conditions(mcp_v=780.0, gate_ns=1.6e7, illuminance_lux=1e-4)
    stacks = (
        held("dark", "dark", flat // 10),
        held("flat-1", "flat", flat, conditions=conditions, asked=Conditions(mcp_v=781.0)),
        held(
            "edge-1",
            "edge",
            flat,
            conditions=conditions,
            target=Target(angle_deg=5.0, region=(10, 20, 60, 80)),
        ),
    )
    return session_in_memory(stacks, name=name, bit_depth=8, interlaced=True, notes=(WIRES,))


def posterior(
    names: tuple[str, ...] = ("tube_frequency_cy_per_px", "exponent", "step_dn"),
) -> Posterior:
    """Correlated Gaussian draws."""
    rng = np.random.default_rng(4)
    draws = rng.multivariate_normal([0, 0, 0], [[1, 0.6, 0], [0.6, 1, 0], [0, 0, 1]], 400)
    return Posterior(
        names=names,
        units=("cy/px", "1", "DN"),
        draws=draws * [0.01, 0.05, 0.5] + [0.18, 1.18, 120],
        acceptance=0.41,
        r_hat=np.array([1.001, 1.002, 1.003]),
        autocorrelation_time=np.array([30.0, 31.0, 29.0]),
        effective_sample_size=np.array([900.0, 800.0, 950.0]),
        seed=77,
        flags=("prior-bound",),
    )


def result() -> Result:
    """One measurement of each verdict, a curve, and evidence of a known, an unknown and a broken
    kind.
    """
    behind = posterior()
    made = Provenance(
        version="9.8.7", seed=77, settings={"window_px": 21}, inputs={"edge-1.tif": DIGEST}
    )
    frequency = np.linspace(0, 0.6, 60)
    mtf = np.exp(-((frequency / 0.25) ** 1.18))
    bands = {
        "interval68": np.array([mtf - 0.01, mtf + 0.01]),
        "interval95": np.array([mtf - 0.02, mtf + 0.02]),
    }
    distance = np.linspace(-10, 10, 120)
    return Result(
        measurements=(
            measurement_from_draws(
                "mtf50",
                "cy/px",
                behind["tube_frequency_cy_per_px"],
                method="edge-forward",
                posterior=behind,
                provenance=made,
                seconds=1.2,
                stack="edge-1",
                region=(10, 20, 60, 80),
            ),
            measurement_from_sd(
                "mtf",
                "1",
                0.55,
                0.02,
                method="bars-forward",
                frequency_cy_per_px=0.15,
                orientation_deg=0.0,
            ),
            measurement_from_sd(
                "covariance_gain",
                "DN",
                3.51,
                0.03,
                method="covariance-sum",
                flags=("lag",),
                notes=(NOTE,),
            ),
            measurement_from_sd("ebi", "lm/cm2", 3.5e-11, 2e-12, method="covariance-sum"),
            make_refusal("halo_diameter", "px", REASON, method="halo-forward"),
        ),
        curves={
            "mtf:edge-1": Curve(frequency_cy_per_px=frequency, value=mtf, stack="edge-1", **bands)
        },
        evidence={
            "never seen": {"figure": "of-tomorrow", "numbers": [1, 2, 3], "strength_dn": 4.5},
            "broken": {"figure": "edge-spread", "distance_px": list(distance)},
        },
    )


@pytest.fixture(scope="session")
def made() -> SimpleNamespace:
    """What this file makes up."""
    return SimpleNamespace(
        held=held,
        session=session,
        posterior=posterior,
        result=result,
        hostile=HOSTILE,
        reason=REASON,
        wires=WIRES,
        note=NOTE,
        digest=DIGEST,
    )
