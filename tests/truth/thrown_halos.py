"""Point sources of exactly known halo, drawn electron by electron: the bounce itself is thrown, no
formula of ours.
"""

import numpy as np

from labdata import Conditions, FrameStack, Session
from tests.truth.sessions import session_in_memory, stack_in_memory

DARK_DN = 12.0
FULL_SCALE_DN = 255.0


def thrown_halo(rng: np.random.Generator, count: int, diameter_px: float, elastic_share: float):
    """Where bounced electrons land: range 2 e d sin(2 t) for emission by the cosine law, four gaps
    are the diameter.
    """
    gap_px = diameter_px / 4.0
    energy = np.where(rng.random(count) < elastic_share, 1.0, rng.random(count))
    # Cosine law: sin^2 of the angle to the normal is uniform.
    angle = np.arcsin(np.sqrt(rng.random(count)))
    radius = 2.0 * energy * gap_px * np.sin(2.0 * angle)
    turn = 2.0 * np.pi * rng.random(count)
    return radius * np.cos(turn), radius * np.sin(turn)


def point_frames(
    rng: np.random.Generator,
    electrons: float,
    *,
    diameter_px: float = 40.0,
    elastic_share: float = 0.4,
    halo_fraction: float = 0.15,
    core_px: float = 1.1,
    gain_dn: float = 3.0,
    frames: int = 6,
    shape: tuple[int, int] = (110, 120),
    pedestal: float = 0.0,
) -> FrameStack:
    """Frames of a point source of so many photoelectrons, blurred after the gain, clipped at full
    scale.
    """
    rows, cols = shape
    images = []
    for _ in range(frames):
        bounced = rng.poisson(electrons * halo_fraction)
        x, y = thrown_halo(rng, bounced, diameter_px, elastic_share)
        direct = rng.poisson(electrons * (1 - halo_fraction))
        x, y = np.concatenate([x, np.zeros(direct)]), np.concatenate([y, np.zeros(direct)])
        # Half of the blur moves single electrons, half spreads whole pulses.
        x += core_px * np.sqrt(0.5) * rng.standard_normal(len(x)) + 0.3
        y += core_px * np.sqrt(0.5) * rng.standard_normal(len(y)) - 0.2
        edges = [np.arange(n + 1) - n / 2.0 for n in (rows, cols)]
        counts = np.histogram2d(y, x, bins=edges)[0] + rng.poisson(pedestal, shape)
        heights = np.where(counts > 0, gain_dn * rng.standard_gamma(np.maximum(counts, 1e-9)), 0.0)
        radius2 = np.fft.fftfreq(rows)[:, None] ** 2 + np.fft.rfftfreq(cols)[None, :] ** 2
        spread = np.exp(-2.0 * np.pi**2 * 0.5 * core_px**2 * radius2)
        blurred = np.fft.irfft2(np.fft.rfft2(heights) * spread, s=shape)
        images.append(DARK_DN + blurred + 0.6 * rng.standard_normal(shape))
    data = np.clip(np.rint(images), 0, FULL_SCALE_DN).astype(np.uint8)
    return FrameStack(data=data, full_scale_dn=FULL_SCALE_DN)


def point_session(stacks: list[tuple[str, FrameStack, float]], *, darks: bool = True) -> Session:
    """A session of point stacks in memory, with a dark one."""
    entries = [
        stack_in_memory("point", frames, Conditions(illuminance_lux=light), label=label)
        for label, frames, light in stacks
    ]
    if darks:
        shape = stacks[0][1].data.shape[1:]
        dark = FrameStack(
            data=np.full((2, *shape), int(DARK_DN), np.uint8), full_scale_dn=FULL_SCALE_DN
        )
        entries.append(stack_in_memory("dark", dark))
    return session_in_memory(entries)
