"""Laboratory data: frames, conditions, sensors, targets, plans, sessions and measurements."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from labdata.background import BackgroundWriter
    from labdata.calibration import GainTable, LampCalibration
    from labdata.camera.description import Camera, has_tube
    from labdata.capture import (
        CameraSettings,
        Frame,
        LostFrames,
        losses_before,
        lost_frames_with_reason,
    )
    from labdata.conditions import Conditions
    from labdata.errors import BadInput
    from labdata.event_log import EventLog, read_events
    from labdata.file_io import write_atomically
    from labdata.flags import FLAGS, order_flags
    from labdata.frame_export import write_frames
    from labdata.frames import Array, FrameStack, Mask
    from labdata.frequency import convert_frequency
    from labdata.gating import Gating, fields_open_ns, out_of_step
    from labdata.importers import read_array, read_frames
    from labdata.instrument_config import InstrumentConfig, Meters
    from labdata.lazy_stack import open_lazy_stack
    from labdata.limits import Limits, Override, limits_in_force
    from labdata.measurement import (
        Curve,
        Measurement,
        Posterior,
        Provenance,
        Result,
        make_measurement,
        make_refusal,
        measurement_from_draws,
        measurement_from_sd,
    )
    from labdata.phosphors import load_phosphor, phosphor_names
    from labdata.plan import (
        FrameFormat,
        Plan,
        SaturationSearch,
        Step,
        StopCriterion,
        by_calibration,
        in_volts,
    )
    from labdata.plan_file import SweepRecord, plan_of, plan_toml, read_plan
    from labdata.quantity import QUANTITIES
    from labdata.schema import file_schema
    from labdata.sensors import load_camera, load_sensor, save_sensor, sensor_names
    from labdata.serialiser import from_mapping, from_toml, read_toml, to_mapping, to_toml
    from labdata.session import (
        MANIFEST,
        LoadedStackEntry,
        Session,
        SessionFile,
        StackEntry,
        open_session,
        sha256_of,
        stack_record,
    )
    from labdata.session_import import import_emva1288, import_frames
    from labdata.session_writer import SessionWriter, StackWriter
    from labdata.settings import Setting, declaration_of, default_option, documented
    from labdata.storage_thread import Storage
    from labdata.target import Kind, Target
    from labdata.tube_dose import Dose, DoseLedger, dose_of, ledger_of, total_dose

__all__ = [
    "FLAGS",
    "MANIFEST",
    "QUANTITIES",
    "Array",
    "BackgroundWriter",
    "BadInput",
    "Camera",
    "CameraSettings",
    "Conditions",
    "Curve",
    "Dose",
    "DoseLedger",
    "EventLog",
    "Frame",
    "FrameFormat",
    "FrameStack",
    "GainTable",
    "Gating",
    "InstrumentConfig",
    "Kind",
    "LampCalibration",
    "Limits",
    "LoadedStackEntry",
    "LostFrames",
    "Mask",
    "Measurement",
    "Meters",
    "Override",
    "Plan",
    "Posterior",
    "Provenance",
    "Result",
    "SaturationSearch",
    "Session",
    "SessionFile",
    "SessionWriter",
    "Setting",
    "StackEntry",
    "StackWriter",
    "Step",
    "StopCriterion",
    "Storage",
    "SweepRecord",
    "Target",
    "by_calibration",
    "convert_frequency",
    "declaration_of",
    "default_option",
    "documented",
    "dose_of",
    "fields_open_ns",
    "file_schema",
    "from_mapping",
    "from_toml",
    "has_tube",
    "import_emva1288",
    "import_frames",
    "in_volts",
    "ledger_of",
    "limits_in_force",
    "load_camera",
    "load_phosphor",
    "load_sensor",
    "losses_before",
    "lost_frames_with_reason",
    "make_measurement",
    "make_refusal",
    "measurement_from_draws",
    "measurement_from_sd",
    "open_lazy_stack",
    "open_session",
    "order_flags",
    "out_of_step",
    "phosphor_names",
    "plan_of",
    "plan_toml",
    "read_array",
    "read_events",
    "read_frames",
    "read_plan",
    "read_toml",
    "save_sensor",
    "sensor_names",
    "sha256_of",
    "stack_record",
    "to_mapping",
    "to_toml",
    "total_dose",
    "write_atomically",
    "write_frames",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "labdata.background": "BackgroundWriter",
        "labdata.calibration": "GainTable LampCalibration",
        "labdata.camera.description": "Camera has_tube",
        "labdata.capture": "CameraSettings Frame LostFrames losses_before lost_frames_with_reason",
        "labdata.conditions": "Conditions",
        "labdata.errors": "BadInput",
        "labdata.event_log": "EventLog read_events",
        "labdata.file_io": "write_atomically",
        "labdata.flags": "FLAGS order_flags",
        "labdata.frame_export": "write_frames",
        "labdata.frames": "Array FrameStack Mask",
        "labdata.gating": "Gating fields_open_ns out_of_step",
        "labdata.importers": "read_array read_frames",
        "labdata.instrument_config": "InstrumentConfig Meters",
        "labdata.lazy_stack": "open_lazy_stack",
        "labdata.limits": "Limits Override limits_in_force",
        "labdata.measurement": (
            "Curve Measurement Posterior Provenance Result make_measurement make_refusal "
            "measurement_from_draws measurement_from_sd"
        ),
        "labdata.phosphors": "load_phosphor phosphor_names",
        "labdata.plan": (
            "FrameFormat Plan SaturationSearch Step StopCriterion by_calibration in_volts"
        ),
        "labdata.plan_file": "SweepRecord plan_of plan_toml read_plan",
        "labdata.frequency": "convert_frequency",
        "labdata.quantity": "QUANTITIES",
        "labdata.schema": "file_schema",
        "labdata.sensors": "load_camera load_sensor save_sensor sensor_names",
        "labdata.serialiser": "from_mapping from_toml read_toml to_mapping to_toml",
        "labdata.session": (
            "LoadedStackEntry MANIFEST Session SessionFile StackEntry open_session "
            "sha256_of stack_record"
        ),
        "labdata.session_import": "import_emva1288 import_frames",
        "labdata.session_writer": "SessionWriter StackWriter",
        "labdata.settings": "Setting declaration_of default_option documented",
        "labdata.storage_thread": "Storage",
        "labdata.target": "Kind Target",
        "labdata.tube_dose": "Dose DoseLedger dose_of ledger_of total_dose",
    },
)
