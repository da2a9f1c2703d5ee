"""The Aravis driver keeps the laws of cameras over a GigE Vision wire that loses none to 5 % of its
packets.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from drivers.cameras.aravis.camera import AravisCamera
from labdata.capture import CameraSettings, Frame
from simulate.virtual_bench import aravis_library
from tests.drivers import pattern_camera
from tests.drivers.camera_laws import Bench, CameraLaws, taken
from tests.drivers.fake_video import luma

pytestmark = [
    pytest.mark.wires,
    pytest.mark.aravis,
    pytest.mark.skipif(
        not aravis_library.is_available(), reason="the Aravis library is not on this machine"
    ),
]
PATIENCE_S = 20.0
SHARES = (0.0, 0.001, 0.01, 0.05)


def is_whole(frame: Frame) -> bool:
    deep = frame.pixels.dtype == np.uint16
    block = (frame.number - 1) % 65535 + 1  # the wire counts 1..65535 and starts again
    return np.array_equal(frame.pixels, luma(block, *frame.pixels.shape, deep=deep))


@contextmanager
def untriggered(identifier: str) -> Iterator[AravisCamera]:
    """The camera waiting for a trigger that nobody gives."""
    with AravisCamera(identifier, silence_s=PATIENCE_S) as camera:
        camera.configure(CameraSettings(trigger="Software"))
        try:
            yield camera
        finally:
            camera.configure(CameraSettings(trigger="off"))


@pytest.fixture(scope="module", params=SHARES, ids=lambda share: f"{share:.1%} of packets lost")
def wire(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, float]]:
    folder: Path = tmp_path_factory.mktemp("camera")
    with pattern_camera.running(folder, request.param) as identifier:
        yield identifier, request.param


class TestAravis(CameraLaws):
    @pytest.fixture
    def laws(self, wire: tuple[str, float]) -> Bench:
        identifier, share = wire
        return Bench(
            open=lambda: AravisCamera(identifier, silence_s=PATIENCE_S),
            quiet=lambda: untriggered(identifier),
            is_whole=is_whole,
            frames=50,
            loses=share > 0,
            counts_from=1,
            asked=(
                CameraSettings(rows=40, columns=64, first_row=3, first_column=8),
                CameraSettings(pixel_format="Mono16"),
                CameraSettings(exposure_s=0.012),
                CameraSettings(gain_db=6.0),
                CameraSettings(frame_rate_hz=80.0),
            ),
            refused=(
                (CameraSettings(rows=5000), "must fit into the sensor's 61 rows and 84 columns"),
                (CameraSettings(first_row=60), "must fit into the sensor's"),
                (CameraSettings(pixel_format="RGB8"), "pixel format must be one of"),
                (CameraSettings(gain_db=99.0), "gain of camera .* must lie in"),
                (CameraSettings(exposure_s=10.0), "exposure of camera .* must lie in"),
                (CameraSettings(field_order="top first"), "field order .* cannot be set"),
            ),
        )


def test_as_many_frames_are_whole_as_packets_that_all_arrive_would_leave(
    wire: tuple[str, float],
) -> None:
    identifier, share = wire
    with AravisCamera(identifier, silence_s=PATIENCE_S) as camera:
        frames, capture = taken(camera, 200)
    numbered = frames[-1].number - frames[0].number + 1
    whole = (1 - share) ** pattern_camera.PACKETS
    expected = numbered * (1 - whole)
    print(
        f"\n    {share:.1%} of packets lost: 200 whole of {numbered} frames, counted lost "
        f"{capture.lost_frames} (expected {expected:.1f}), packets lost {capture.lost_packets}, "
        f"sent again {capture.resent_packets}"
    )
    assert all(is_whole(frame) for frame in frames)
    # As rare on either side as four standard errors.
    assert (
        binom.ppf(3e-5, numbered, 1 - whole)
        <= capture.lost_frames
        <= binom.ppf(1 - 3e-5, numbered, 1 - whole)
    )
    assert capture.lost_packets > 0 or capture.lost_frames == 0
    assert capture.resent_packets == 0


def test_a_trigger_is_set_read_back_and_switched_off(wire: tuple[str, float]) -> None:
    identifier, _ = wire
    with AravisCamera(identifier, silence_s=PATIENCE_S) as camera:
        assert camera.configure(CameraSettings()).trigger == "off"
        assert camera.configure(CameraSettings(trigger="Software")).trigger == "Software"
        assert camera.configure(CameraSettings(trigger="off")).trigger == "off"
        assert len(taken(camera, 2)[0]) == 2
