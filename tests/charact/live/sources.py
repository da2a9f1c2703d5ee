"""Sources of known frames for the bench's tests."""

import time
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from threading import Event

import numpy as np
from numpy.typing import NDArray

from charact.live import SourceFrame
from charact.method import Context
from labdata.capture import Frame
from tests.truth import EdgeScene, TrueBlur


def seen(
    pixels: NDArray, number: int, *, full_scale_dn: float = 255.0, of: str = "a camera"
) -> SourceFrame:
    """A frame thirty of which come in a second."""
    return SourceFrame(
        frame=Frame(pixels=pixels, number=number, time_s=number / 30.0),
        of=of,
        full_scale_dn=full_scale_dn,
    )


@dataclass
class Told:
    """A source that hands out given frames and then ends, or waits to be let go."""

    frames: list[SourceFrame]
    name: str = "a told source"
    context: Context = field(default_factory=lambda: Context(quick=True))
    let_go: Event | None = None
    pause_s: float = 0.0

    def __iter__(self) -> Iterator[SourceFrame | None]:
        for frame in self.frames:
            yield frame
            time.sleep(self.pause_s)
        while self.let_go is not None and not self.let_go.wait(0.01):
            yield None


def noisy(
    rng: np.random.Generator, *, mean_dn: float = 100.0, sd_dn: float = 3.0, shape=(128, 160)
) -> NDArray:
    return np.rint(rng.normal(mean_dn, sd_dn, shape)).astype(np.uint8)


def edge(rng: np.random.Generator, *, blur_px: float, shape=(160, 160)) -> NDArray:
    """A slanted edge blurred by a Gaussian and the pixel, with noise of 2 DN."""
    blur, (rows, cols) = TrueBlur(sigma_px=blur_px), shape
    scene = EdgeScene(blur=blur, rows=rows, cols=cols, snr=75.0, shot_share=0.0)
    return scene.frames_drawn(rng).data[0].copy()


class AtOnce(Executor):
    """Does what it is given in this thread."""

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[override]
        done: Future = Future()
        done.set_result(fn(*args, **kwargs))
        return done
