"""Frames a second of other simulators on one scene, in an environment of their own: prints JSON,
one number a peer.

Called with the path of a scene, mean photoelectrons per pixel (.npy). `make .venv-peers/ready` sets
the environment up.
"""

import json
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

REPEATS = 5
BLUR_PX = 1.0


def seconds(frame) -> float:
    """The shortest of several times of a frame, s."""
    frame()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        frame()
        times.append(time.perf_counter() - start)
    return min(times)


def emccd_detect(scene: np.ndarray) -> float:
    """Shot noise, dark current, clock-induced charge, register of gain 1000, read noise, digitiser;
    no blur.
    """
    from emccd_detect.emccd_detect import EMCCDDetectBase

    camera = EMCCDDetectBase(
        em_gain=1000.0,
        full_well_image=60000.0,
        full_well_serial=100000.0,
        dark_current=0.0,
        cic=0.02,
        read_noise=100.0,
        bias=2000.0,
        qe=1.0,
        cr_rate=0.0,
        pixel_pitch=13e-6,
        eperdn=7.0,
        nbits=14,
        numel_gain_register=604,
    )
    # Its faster mode: the register by a gamma law, not stage by stage (then a frame takes many
    # seconds).
    camera.fast_gain_mode = True
    camera.n1_fast = True
    return seconds(lambda: camera.sim_sub_frame(scene, 1.0))


def pyxel(scene: np.ndarray) -> float:
    """A blur, shot noise, conversion, a second blur, full well, read noise, digitiser; no gain
    noise.
    """
    from pyxel.detectors import CCD, CCDGeometry, Characteristics, Environment
    from pyxel.detectors.characteristics import ChargeToVoltSettings
    from pyxel.models.charge_collection import simple_collection, simple_full_well
    from pyxel.models.charge_generation import simple_conversion
    from pyxel.models.charge_measurement import output_node_noise, simple_measurement
    from pyxel.models.photon_collection import load_psf, shot_noise
    from pyxel.models.readout_electronics import simple_adc, simple_amplifier

    rows, cols = scene.shape
    detector = CCD(
        geometry=CCDGeometry(
            row=rows, col=cols, total_thickness=40.0, pixel_vert_size=13.0, pixel_horz_size=11.0
        ),
        environment=Environment(temperature=290.0),
        characteristics=Characteristics(
            quantum_efficiency=1.0,
            charge_to_volt=ChargeToVoltSettings(value=1e-6),
            pre_amplification=4,
            full_well_capacity=50000,
            adc_voltage_range=(0.0, 1.0),
            adc_bit_resolution=8,
        ),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "psf.npy"
        y, x = np.mgrid[-6:7, -6:7]
        np.save(path, np.exp(-(x**2 + y**2) / (2.0 * BLUR_PX**2)))

        def frame() -> None:
            detector.empty()
            detector.photon.array = scene.copy()
            load_psf(detector, filename=path)
            shot_noise(detector)
            load_psf(detector, filename=path)
            simple_conversion(detector)
            simple_collection(detector)
            simple_full_well(detector)
            simple_measurement(detector)
            output_node_noise(detector, std_deviation=5e-5)
            simple_amplifier(detector)
            simple_adc(detector)

        return seconds(frame)


def main() -> None:
    """Time every peer that is installed."""
    warnings.simplefilter("ignore")
    scene = np.load(sys.argv[1]).astype(float)
    print(json.dumps({peer.__name__: 1.0 / peer(scene) for peer in (emccd_detect, pyxel)}))


if __name__ == "__main__":
    main()
