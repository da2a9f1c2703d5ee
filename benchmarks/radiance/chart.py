"""Error over time of ours and of a path tracer, scene by scene: chart and table."""

from pathlib import Path

import numpy as np

COLOURS = {"ours": "#4477aa", "Mitsuba": "#ee6677"}
MARKS = {"ours": "o", "Mitsuba": "s"}
TITLES = {"median": "median relative error", "rms": "relative RMSE"}
NAMES = {
    "yard": "yard, direct light",
    "lab": "lab bench",
    "hangar": "hangar",
    "road": "road",
    "room": "closed room",
}
# Relative RMSE at which times are compared.
LEVELS = (0.01, 0.004)
# Times are carried on to errors so many times smaller than any that was measured, and no further.
FAR = 2.0
# Median errors are compared down to what either was measured at, and to so many times that of the
# reference, which is part of them.
CLEAR = 2.0


def draw(told: dict, path: Path) -> None:
    """Draw a column of two charts for each scene."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import NullFormatter

    scenes = _scenes(told)
    figure, axes = plt.subplots(
        2,
        len(scenes),
        figsize=(3.0 * len(scenes), 5.6),
        layout="constrained",
        sharex="col",
        squeeze=False,
    )
    for column, scene in enumerate(scenes):
        for row, kind in enumerate(TITLES):
            axis = axes[row, column]
            for who in COLOURS:
                x, y = _curve(told, scene, who, kind)
                axis.loglog(x, y, MARKS[who], color=COLOURS[who], label=who, ms=5)
                axis.loglog(*_best(x, y), "-", color=COLOURS[who])
            if kind == "median":
                axis.axhline(told["references"][scene]["median_noise"], color="0.5", lw=1, ls=":")
                axis.set_title(NAMES[scene])
            axis.grid(which="major", alpha=0.3)
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.set_ylabel(TITLES[kind] if column == 0 else "")
        axes[1, column].set_xlabel("seconds of two cores")
    axes[0, 0].legend(fontsize=8)
    axes[0, -1].annotate(
        "dotted: noise of the reference",
        (0.98, 0.96),
        xycoords="axes fraction",
        fontsize=7,
        ha="right",
        va="top",
    )
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def table(told: dict) -> str:
    """Return the table for the page."""
    lines = [
        (
            "| scene | who | setting | seconds of two cores | on the clock, s | median error | "
            "RMSE | mean difference |"
        ),
        "|---|---|---|---|---|---|---|---|",
    ]
    for scene in _scenes(told):
        lines += [_line(row) for row in told["rows"] if row["scene"] == scene]
    lines += ["", *_verdicts(told)]
    return "\n".join(lines)


def _line(row: dict) -> str:
    cells = (
        *(row["scene"], row["who"], row["setting"]),
        *(f"{0.5 * row['core_seconds']:.2f}", f"{row['seconds']:.2f}"),
        *(f"{row['median']:.4f}", f"{row['rms']:.4f}", f"{100.0 * row['mean']:+.2f} %"),
    )
    return f"| {' | '.join(cells)} |"


def _verdicts(told: dict) -> list[str]:
    lines = [
        "| scene | our time over Mitsuba's at the same median error, least and most | "
        + " | ".join(f"at RMSE {level:g}" for level in LEVELS)
        + " |",
        "|---|---|" + "---|" * len(LEVELS),
    ]
    for scene in _scenes(told):
        known = told["references"][scene]["median_noise"]
        x, y = _best(*_curve(told, scene, "ours", "median"))
        theirs = _best(*_curve(told, scene, "Mitsuba", "median"))
        both = (y > CLEAR * known) & (y >= theirs[1].min())
        ratios = [
            time / _time_at(*theirs, error) for time, error in zip(x[both], y[both], strict=True)
        ]
        at = [_compared(told, scene, level) for level in LEVELS]
        lines.append(
            f"| {scene} | {min(ratios):.2g} to {max(ratios):.2g} | " + " | ".join(at) + " |"
        )
    return lines


def _compared(told: dict, scene: str, level: float) -> str:
    """Our time over the peer's at an RMSE, or who came nowhere near it."""
    curves = {who: _best(*_curve(told, scene, who, "rms")) for who in COLOURS}
    far = [who for who, (_, errors) in curves.items() if errors.min() > FAR * level]
    if far:
        return "not reached by " + " nor ".join(far)
    ours, theirs = (_time_at(*curves[who], level) for who in COLOURS)
    return f"{ours / theirs:.2g}"


def _scenes(told: dict) -> list[str]:
    have = {row["scene"] for row in told["rows"]}
    return [scene for scene in NAMES if scene in have]


def _curve(told: dict, scene: str, who: str, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of two cores and errors, by time."""
    rows = [row for row in told["rows"] if row["scene"] == scene and row["who"] == who]
    points = sorted((0.5 * row["core_seconds"], row[kind]) for row in rows)
    return np.array([point[0] for point in points]), np.maximum(
        [point[1] for point in points], 1e-6
    )


def _best(seconds: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Those points, by time, that are better than all that took less."""
    better = errors < np.minimum.accumulate(np.concatenate([[np.inf], errors[:-1]]))
    return seconds[better], errors[better]


def _time_at(seconds: np.ndarray, errors: np.ndarray, level: float) -> float:
    """Time at which an error is reached: between points by a power law, beyond them by the last two
    points' law.
    """
    log_time, log_error = np.log(seconds), np.log(np.minimum.accumulate(errors))
    order = np.argsort(-log_error, kind="stable")
    log_time, log_error = log_time[order], log_error[order]
    target = np.log(level)
    after = int(np.clip(np.searchsorted(-log_error, -target), 1, len(log_error) - 1))
    step = log_error[after] - log_error[after - 1]
    share = (target - log_error[after - 1]) / step if step else 0.0
    return float(np.exp(log_time[after - 1] + share * (log_time[after] - log_time[after - 1])))
