"""How a point method does on spots of closed form: bias without noise, scatter over Cramer-Rao's, cover of intervals.

`python -m charact.study.point.coverage` prints the three tables.
"""

import argparse
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, choose
from charact.study.point.spots import Spot, SpotCamera

Array = NDArray[np.float64]

DIRECTIONS = (0.0, 90.0)
SPOTS: dict[str, Spot] = {
    "gaussian 0.5 px": Spot(width=0.5),
    "gaussian 1 px": Spot(),
    "gaussian 2 px": Spot(width=2.0),
    "elliptical": Spot(stretch=0.25),
    "exponential n 1.1": Spot(form="exponential", width=0.25, exponent=1.1),
    "exponential n 1.6": Spot(form="exponential", width=0.25, exponent=1.6),
    "moffat b 2.5": Spot(form="moffat", width=2.0, exponent=2.5),
    "core and halo": Spot(form="halo", width=0.9, share=0.06, disc_px=24.0),
}


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a method said of one direction of one spot, and the truth."""

    case: str
    truth: float
    value: float | None
    interval68: tuple[float, float] | None
    interval95: tuple[float, float] | None
    status: str
    flags: tuple[str, ...]
    seconds: float

    @property
    def error(self) -> float:
        """Relative error, dimensionless."""
        return np.nan if self.value is None else self.value / self.truth - 1.0


def measured(method: str, case: str, spot: Spot, camera: SpotCamera, seed: int, **told) -> list[Found]:
    """Give one spot to a method; return both directions' MTF50."""
    stack = camera.taken(spot, np.random.default_rng(seed))
    result = choose("point", method).function(stack, context=Context(quick=True, seed=seed), **told)
    out = []
    for angle in DIRECTIONS:
        (one,) = result.find("mtf50", orientation_deg=angle)
        truth = spot.level(0.5, vertical=angle > 0)
        out.append(Found(case=case, truth=truth, value=one.value, interval68=one.interval68, interval95=one.interval95,
                         status=one.status, flags=one.flags, seconds=one.seconds or 0.0))  # fmt: skip
    return out


def placed(spot: Spot, rng: np.random.Generator) -> Spot:
    """Return a spot anywhere within a pixel."""
    return replace(spot, row_px=float(rng.uniform(-0.5, 0.5)), col_px=float(rng.uniform(-0.5, 0.5)))


def mixed(rng: np.random.Generator) -> tuple[str, Spot, SpotCamera, dict]:
    """Draw a case: form, ellipse, pinhole, peak over noise, shot noise, correlation, full scale; what is told of it."""
    kind = str(rng.choice(["gaussian", "exponential", "moffat", "halo"]))
    spot = {
        "gaussian": Spot(width=float(rng.uniform(0.5, 1.6))),
        "exponential": Spot(form="exponential", width=float(rng.uniform(0.15, 0.35)),
                            exponent=float(np.clip(rng.normal(1.6, 0.4), 1.1, 3.0))),
        "moffat": Spot(form="moffat", width=float(rng.uniform(1.2, 2.5)), exponent=float(rng.uniform(1.8, 5.0))),
        "halo": Spot(form="halo", width=float(rng.uniform(0.6, 1.3)), share=float(rng.uniform(0.02, 0.15)),
                     disc_px=float(rng.uniform(10.0, 36.0))),
    }[kind]  # fmt: skip
    spot = replace(placed(spot, rng), stretch=float(rng.normal(0.0, 0.1)))
    told: dict = {}
    if rng.random() < 0.25:
        most = float(rng.choice([1.5, 3.0]))
        spot, told = replace(spot, pinhole_px=float(rng.uniform(0.0, most))), {"pinhole_px": (0.0, most)}
        kind += ", pinhole"
    camera = SpotCamera(
        snr=float(np.exp(rng.uniform(np.log(5.0), np.log(50.0)))),
        shot_share=float(rng.choice([0.0, 0.5, 0.9])),
        noise_blur_px=float(rng.choice([0.0, 0.0, 0.7])),
        frames=int(rng.choice([2, 4, 8])),
    )
    if rng.random() < 0.25:
        camera = replace(camera, full_scale_dn=20.0 + camera.peak_dn * float(rng.uniform(0.5, 0.9)))
        kind += ", cut"
    if camera.noise_blur_px:
        kind += ", grain"
    return kind, spot, camera, told


def cramer_rao(spot: Spot, camera: SpotCamera) -> float:
    """Return the least relative error of the horizontal MTF50, dimensionless, for white noise.

    Place, light, level, slopes, width, ellipse and, but for a Gaussian, the exponent are free.
    """
    free = ["row_px", "col_px", "width", "stretch", *(["exponent"] if spot.form != "gaussian" else [])]
    size, step = camera.size, 1e-4
    shape = spot.picture(size, size)
    scale = camera.peak_dn / shape.max()
    slopes = [scale * _changed(lambda s: s.picture(size, size), spot, name, step) for name in free]
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    columns = np.stack([part.ravel() for part in (*slopes, scale * shape, np.ones_like(shape), x, y)], axis=1)
    variance = (camera.peak_dn / camera.snr) ** 2
    noise = variance * (1.0 - camera.shot_share + camera.shot_share * scale * shape.ravel() / camera.peak_dn)
    fisher = columns.T @ (columns / noise[:, None]) * camera.frames
    covariance = np.linalg.inv(fisher)[: len(free), : len(free)]
    gradient = np.array([_changed(lambda s: s.level(0.5), spot, name, step) for name in free])
    return float(np.sqrt(gradient @ covariance @ gradient)) / spot.level(0.5)


def _changed(of, spot: Spot, name: str, step: float):
    """Return the derivative of something to a parameter of a spot."""
    high, low = (replace(spot, **{name: getattr(spot, name) + sign * step}) for sign in (1, -1))
    return (of(high) - of(low)) / (2.0 * step)


def bias_table(method: str, rng: np.random.Generator) -> str:
    """Return errors of MTF50 without noise, both directions."""
    lines = ["| form | horizontal error, % | vertical error, % | status |", "|---|---|---|---|"]
    for name, spot in SPOTS.items():
        pair = measured(method, name, placed(spot, rng), SpotCamera(snr=np.inf), 1)
        errors = " | ".join(f"{100 * one.error:+.3f}" for one in pair)
        lines.append(f"| {name} | {errors} | {pair[0].status} {' '.join(pair[0].flags)} |")
    return "\n".join(lines)


def scatter_table(method: str, rng: np.random.Generator, repeats: int) -> str:
    """Return the scatter of MTF50 over many draws beside the Cramer-Rao bound; one frame of white noise each."""
    lines = ["| form | peak over noise | rms error, % | Cramer-Rao, % | ratio | ok |", "|---|---|---|---|---|---|"]
    for name in ("gaussian 1 px", "exponential n 1.6"):
        for snr in (100.0, 30.0, 10.0, 5.0):
            camera = SpotCamera(snr=snr, frames=4, shot_share=0.0)
            rows = [
                measured(method, name, placed(SPOTS[name], rng), camera, int(rng.integers(1 << 31)))[0]
                for _ in range(repeats)
            ]
            errors = np.array([one.error for one in rows if one.value is not None])
            rms = 100 * float(np.sqrt(np.mean(errors**2))) if errors.size else np.nan
            bound = 100 * cramer_rao(SPOTS[name], camera)
            ok = np.mean([one.status == "ok" for one in rows])
            lines.append(f"| {name} | {snr:g} | {rms:.2f} | {bound:.2f} | {rms / bound:.2f} | {100 * ok:.0f} % |")
    return "\n".join(lines)


def cover_rows(method: str, rng: np.random.Generator, cases: int) -> list[Found]:
    """Measure mixed cases, both directions of each."""
    out: list[Found] = []
    for _ in range(cases):
        kind, spot, camera, told = mixed(rng)
        out += measured(method, kind, spot, camera, int(rng.integers(1 << 31)), **told)
    return out


def cover_table(rows: list[Found]) -> str:
    """Return cover of the intervals of what is ok, by kind of case, and silent failures."""
    parts = sorted({part.strip() for row in rows for part in row.case.split(",")})
    lines = [
        "| cases | values | ok | in 68 % | in 95 % | silent | median 95 % half width, % |",
        "|---|---|---|---|---|---|---|",
    ]
    for part in ("all", *parts):
        own = [row for row in rows if part == "all" or part in [one.strip() for one in row.case.split(",")]]
        sure = [row for row in own if row.status == "ok" and row.interval68 and row.interval95]
        if not sure:
            continue
        in68 = np.mean([row.interval68[0] <= row.truth <= row.interval68[1] for row in sure])  # type: ignore[index]
        in95 = np.mean([row.interval95[0] <= row.truth <= row.interval95[1] for row in sure])  # type: ignore[index]
        width = np.median([(row.interval95[1] - row.interval95[0]) / 2 / row.truth for row in sure])  # type: ignore[index]
        lines.append(
            f"| {part} | {len(own)} | {100 * len(sure) / len(own):.0f} % | {100 * in68:.1f} | {100 * in95:.1f} | "
            f"{sum(silent(row) for row in sure)} | {100 * width:.2f} |"
        )
    return "\n".join(lines)


def silent(row: Found) -> bool:
    """Tell whether a value is ok and the truth further from it than twice the 95 % half interval on that side."""
    if row.status != "ok" or row.value is None or row.interval95 is None:
        return False
    off = row.truth - row.value
    half = row.interval95[1] - row.value if off > 0 else row.value - row.interval95[0]
    return bool(abs(off) > 2.0 * half)


def main() -> None:
    """Print the tables of a method."""
    import charact.mtf  # noqa: F401  registers the methods

    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--method", default="point-parametric")
    asked.add_argument("--cases", type=int, default=400)
    asked.add_argument("--repeats", type=int, default=60)
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    rng = np.random.default_rng(given.seed)
    print(f"{given.method}, seed {given.seed}\n\n{bias_table(given.method, rng)}\n")
    print(f"{scatter_table(given.method, rng, given.repeats)}\n")
    rows = cover_rows(given.method, rng, given.cases)
    print(cover_table(rows))
    print(f"\nmedian {np.median([row.seconds for row in rows]):.3f} s a spot")


if __name__ == "__main__":
    main()
