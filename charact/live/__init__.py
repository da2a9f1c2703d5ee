"""Live view and quick results during an acquisition; read-only, no tube or camera setting is
changed.
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from charact.live.doctor import Finding, examine, video_devices
    from charact.live.focus import AVERAGED_FRAMES, BestFocus, Focus, FocusReader, read_focus
    from charact.live.frame_source import CameraSource, SessionSource, SourceFrame
    from charact.live.judge import SaturationJudge, half_interval_dn
    from charact.live.live_loop import FrameRate, LiveLoop
    from charact.live.live_view import SATURATED_BGR, measure_frame, render_preview
    from charact.live.quick_look import look_at, run_outcome, watch_files, watch_stacks
    from charact.live.terminal import lines, watch_on_terminal

__all__ = [
    "AVERAGED_FRAMES",
    "SATURATED_BGR",
    "BestFocus",
    "CameraSource",
    "Finding",
    "Focus",
    "FocusReader",
    "FrameRate",
    "LiveLoop",
    "SaturationJudge",
    "SessionSource",
    "SourceFrame",
    "examine",
    "half_interval_dn",
    "lines",
    "look_at",
    "measure_frame",
    "read_focus",
    "render_preview",
    "run_outcome",
    "video_devices",
    "watch_files",
    "watch_on_terminal",
    "watch_stacks",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.live.doctor": "Finding examine video_devices",
        "charact.live.focus": "AVERAGED_FRAMES BestFocus Focus FocusReader read_focus",
        "charact.live.frame_source": "CameraSource SessionSource SourceFrame",
        "charact.live.judge": "SaturationJudge half_interval_dn",
        "charact.live.live_loop": "FrameRate LiveLoop",
        "charact.live.live_view": "SATURATED_BGR measure_frame render_preview",
        "charact.live.quick_look": "look_at run_outcome watch_files watch_stacks",
        "charact.live.terminal": "lines watch_on_terminal",
    },
)
