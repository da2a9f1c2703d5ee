"""Edges of exactly known MTF: the frame of a blurred step by numerical transform, and its noise,
from no simulator.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labdata import BadInput
from tests.truth.blur import Array, TrueBlur, level_crossing
from tests.truth.camera_effects import TargetScene, boost

# Places of a rough edge's course to a px.
COURSE_PER_PX = 8
# Step of the tabulated edge spread, px, and its length: 8192 px hold the tails of exp(-(f/fc)^n).
STEP_PX = 1 / 64
SAMPLES = 1 << 19


@lru_cache(maxsize=64)
def _edge_spread(blur: TrueBlur, angle_deg: float) -> tuple[Array, Array]:
    """Distance, px, and edge spread from 0 to 1: running sum of the line spread over cells of exact
    integral.
    """
    frequency = np.fft.rfftfreq(SAMPLES, STEP_PX)
    # Dividing by the cell's own transform makes the sum over whole cells the integral between their
    # borders.
    transform = blur.mtf(frequency, angle_deg) / np.sinc(frequency * STEP_PX)
    line_spread = np.fft.fftshift(np.fft.irfft(transform, SAMPLES)) / STEP_PX
    distance = (np.arange(SAMPLES) - SAMPLES // 2 + 0.5) * STEP_PX
    central = np.abs(distance) < 2048
    return distance[central], (np.cumsum(line_spread) * STEP_PX)[central]


def edge_spread(blur: TrueBlur, distance_px: Array, angle_deg: float) -> Array:
    """Edge spread, 0 on the dark and 1 on the bright side, at signed distances from the edge.

    `distance_px`: distance along the normal, px, any shape; `angle_deg`: angle of the normal to the
    rows, degrees.
    """
    distance, spread = _edge_spread(blur, round(float(angle_deg), 9))
    return np.interp(distance_px, distance, spread)


def distance_across(
    row: Array,
    col: Array,
    size: tuple[int, int],
    *,
    angle_deg: float,
    moved_px: Array | float,
    sagitta_px: float,
) -> Array:
    """Signed distance along its normal from an edge through the middle of a frame, px.

    `row`, `col`: places from the middle, shapes (row, 1) and (1, col), px; `size`: rows and columns
    of the frame; `angle_deg`: angle of the normal to the rows, degrees; `moved_px`: displacement of
    the edge along the rows, px; `sagitta_px`: bow of the edge over its length in the frame, px.
    """
    angle = np.deg2rad(angle_deg)
    along = row * np.cos(angle) - col * np.sin(angle)
    length = min(size[0] / max(abs(np.cos(angle)), 1e-9), size[1] / max(abs(np.sin(angle)), 1e-9))
    bow = sagitta_px * (1 - (2 * along / length) ** 2)
    return (col - moved_px) * np.cos(angle) + row * np.sin(angle) - bow


@dataclass(frozen=True, kw_only=True)
class EdgeScene(TargetScene):
    """A blurred step.

    Parameters
    ----------
    offset_px
        Where the edge passes the middle of the frame, px along the normal.
    dark_dn, bright_dn
        Levels on both sides, DN, black level included.
    sagitta_px
        Bow of the edge over its length in the frame, px.
    roughness_px, roughness_length_px
        Root mean square of how far the edge wanders along its length, the same in all frames, and
        the standard deviation of the Gaussian that smooths its course, px. Seen by the camera
        without loss, as courses are that are long compared with the blur.
    """

    offset_px: float = 0.0
    dark_dn: float = 40.0
    bright_dn: float = 190.0
    sagitta_px: float = 0.0
    roughness_px: float = 0.0
    roughness_length_px: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.clip_share < 1:
            raise BadInput(f"clip_share must lie in [0, 1), got {self.clip_share:g}")

    @property
    def levels_dn(self) -> tuple[float, float]:
        """Levels of the dark and the bright side, DN, black level included."""
        return self.dark_dn, self.bright_dn

    @property
    def truth_mtf50(self) -> float:
        """MTF50 along the edge's normal, cycles per pixel."""
        return level_crossing(
            lambda f: self.blur.mtf(f, self.angle_deg) * boost(f, self.sharpening), 0.5
        )

    def light(self, moved_px: float = 0.0, course_px: Array | float = 0.0) -> Array:
        """Noiseless light signal over black, DN of a straight response, shape (row, col).

        `moved_px`: horizontal displacement of the edge, px; `course_px`: how far the edge lies off
        its line along the normal, seen from each pixel, shape (row, col), px.
        """
        row = np.arange(self.rows)[:, None] - (self.rows - 1) / 2
        col = np.arange(self.cols)[None, :] - (self.cols - 1) / 2
        displacement = moved_px + self.motion_px * (np.arange(self.rows) % 2)[:, None]
        distance = distance_across(
            row,
            col,
            (self.rows, self.cols),
            angle_deg=self.angle_deg,
            moved_px=displacement,
            sagitta_px=self.sagitta_px,
        )
        distance = distance - self.offset_px - course_px
        step = self.bright_dn - self.dark_dn
        light = (
            self.dark_dn - self.black_dn + step * edge_spread(self.blur, distance, self.angle_deg)
        )
        light = light * (1 + self.gradient * (col / self.cols + 0.5))
        # Clipping is a matter of exposure: the light grows until the share of the step lies above
        # full scale.
        if self.clip_share > 0:
            room = self.full_scale_dn - self.black_dn
            light = light * room / (self.bright_dn - self.black_dn - self.clip_share * step)
        return light

    def _frames_light(self, rng: np.random.Generator) -> Array:
        """Light of every frame, or of all of them where nothing moves."""
        course = self._course(rng) if self.roughness_px else 0.0
        if not self.jitter_px:
            return self.light(course_px=course)
        offsets_px = self.jitter_px * rng.standard_normal(self.frames)
        return np.stack([self.light(offset_px, course) for offset_px in offsets_px])

    def _course(self, rng: np.random.Generator) -> Array:
        """How far a rough edge lies off its line, seen from each pixel, px."""
        from scipy.ndimage import gaussian_filter1d

        angle = np.deg2rad(self.angle_deg)
        row = np.arange(self.rows)[:, None] - (self.rows - 1) / 2
        col = np.arange(self.cols)[None, :] - (self.cols - 1) / 2
        along = row * np.cos(angle) - col * np.sin(angle)
        half_length = 0.5 * np.hypot(self.rows, self.cols) + 1.0
        position = np.arange(-half_length, half_length, 1 / COURSE_PER_PX)
        course = gaussian_filter1d(
            rng.standard_normal(position.size), self.roughness_length_px * COURSE_PER_PX
        )
        return np.interp(along, position, self.roughness_px * course / np.std(course))
