"""The picture of a plan: what is asked of the camera for all steps, whether its sensor has it, and how large it is."""

from dataclasses import replace

from labdata.capture import PIXEL_BITS, CameraSettings
from labdata.errors import BadInput
from labdata.plan import Plan
from labdata.sensor import Sensor


def picture_of(plan: Plan, sensor: Sensor | None) -> CameraSettings:
    """Ask for what the plan names, else for the whole sensor of the description; the rest stays as it is."""
    asked = {name: value for name, value in vars(plan.picture).items() if value is not None}
    return replace(_whole(sensor), **asked)


def frame_bytes_of(plan: Plan, sensor: Sensor | None) -> int:
    """Bytes of one stored frame; 0 where nobody tells its size."""
    picture = picture_of(plan, sensor)
    if picture.rows is None or picture.columns is None:
        return 0
    return picture.rows * picture.columns * (1 if PIXEL_BITS[picture.pixel_format or "Mono16"] <= 8 else 2)


def check_picture(plan: Plan, sensor: Sensor | None) -> None:
    """Refuse (BadInput) a picture that the sensor does not have, parts its fields, or cuts its codes."""
    if sensor is None:
        return
    asked = picture_of(plan, sensor)
    for first, size, there in (
        ("first_row", "rows", sensor.ccd.rows),
        ("first_column", "columns", sensor.ccd.columns),
    ):
        end = (getattr(asked, first) or 0) + (getattr(asked, size) or 0)
        if end > there:
            raise BadInput(f"{first} + {size} of the picture must not exceed the sensor's {there}, got {end}")
    if sensor.video.interlaced and (asked.first_row or 0) % 2:
        raise BadInput(f"first_row of interlaced video must be even, so that fields keep order, got {asked.first_row}")
    bits = PIXEL_BITS[asked.pixel_format or "Mono16"]
    if bits < sensor.video.bit_depth:
        raise BadInput(
            f"pixel_format must hold the sensor's {sensor.video.bit_depth} bits, got {asked.pixel_format} of {bits}"
        )


def _whole(sensor: Sensor | None) -> CameraSettings:
    """Ask for the whole sensor at its depth; without a description the camera stays as it is."""
    if sensor is None:
        return CameraSettings()
    wide = "Mono8" if sensor.video.bit_depth <= 8 else "Mono16"
    return CameraSettings(
        rows=sensor.ccd.rows, columns=sensor.ccd.columns, first_row=0, first_column=0, pixel_format=wide
    )
