"""Video filter: causal low-pass along the rows with an uncertain bandwidth."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdata.camera.description import Camera, has_tube

Array = NDArray[np.float64]

# Bandwidths at which the transfer function is computed, in standard deviations of ln(bandwidth). A
# polynomial of its logarithm interpolates within 3e-4 for a bandwidth known to 4 %.
NODES_SD = np.array([-4.0, -2.75, -1.25, 1.25, 2.75, 4.0])


@dataclass(frozen=True, kw_only=True)
class VideoFilter:
    """Butterworth low-pass of a sample-and-hold signal, sampled at the pixel clock, linear phase
    removed.

    Parameters
    ----------
    bandwidth_mhz, clock_mhz
        Described bandwidth (3 dB) and pixel clock, MHz.
    order
        Order of the filter.
    ln_bandwidth_sd
        Standard deviation of ln of the bandwidth about the described one, dimensionless.
    """

    bandwidth_mhz: float
    clock_mhz: float
    order: int
    ln_bandwidth_sd: float = 0.0

    @classmethod
    def of(cls, sensor: Camera | None) -> "VideoFilter | None":
        """Return the filter of a sensor description; None for a digital camera or without
        description.
        """
        if not has_tube(sensor) or sensor.video.low_pass is None:
            return None
        bandwidth, clock, order = sensor.video.low_pass
        known = sensor.video.bandwidth_mhz
        assert known is not None
        # A 95 % range is 2 x 1.96 standard deviations wide.
        sd = (
            0.0
            if known.low is None or known.high is None
            else (known.high - known.low) / (2.0 * 1.959964) / bandwidth
        )
        return cls(bandwidth_mhz=bandwidth, clock_mhz=clock, order=order, ln_bandwidth_sd=sd)

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds (6 standard deviations) of the free parameters by name; empty if the
        bandwidth is exact.
        """
        bound = 6.0 * self.ln_bandwidth_sd
        return {"ln_video_bandwidth": ("1", (-bound, bound))} if bound > 0.0 else {}

    def __call__(self, frequency: Array) -> NDArray[np.complex128]:
        """Return the complex transfer function at the described bandwidth; frequency along the
        rows, cy/px.
        """
        return self._at(frequency, 0.0)

    def bend(self, frequency: Array) -> NDArray[np.complex128]:
        """Return how ln of the transfer moves with x, ln of bandwidth over described: coefficients
        of x, x^2, ...

        The transfer of another bandwidth is `self(frequency) * exp(powers(x) @ bend)`, shape of
        bend (power, f).
        """
        nodes = NODES_SD * max(self.ln_bandwidth_sd, 1e-3)
        described = int(np.searchsorted(nodes, 0.0))
        transfers = np.array([self._at(frequency, x) for x in np.insert(nodes, described, 0.0)])
        # Phase steps between neighbouring nodes stay below pi.
        steps = np.log(transfers[1:] / transfers[:-1])
        ln_change = np.concatenate(
            [
                -np.cumsum(steps[:described][::-1], axis=0)[::-1],
                np.cumsum(steps[described:], axis=0),
            ]
        )
        return np.asarray(np.linalg.solve(powers(nodes), ln_change), np.complex128)

    def doubt(self, frequency: Array) -> Array:
        """Return the relative standard uncertainty of the transfer function due to the bandwidth,
        shape (f,).
        """
        return np.abs(self.bend(frequency)[0].real) * self.ln_bandwidth_sd

    def log_prior(self, ln_bandwidth: Array) -> Array:
        """Return the log density of the normal prior of ln(bandwidth / described bandwidth), shape
        (n,).
        """
        return -0.5 * (ln_bandwidth / self.ln_bandwidth_sd) ** 2 - np.log(
            self.ln_bandwidth_sd * np.sqrt(2.0 * np.pi)
        )

    def _at(self, frequency: Array, ln_bandwidth: float) -> NDArray[np.complex128]:
        bandwidth = self.bandwidth_mhz * float(np.exp(ln_bandwidth))
        flat = np.ravel(frequency)
        # Images and spectra repeat few frequencies.
        different, position = np.unique(flat, return_inverse=True)
        if different.size == 1:
            different, position = flat, slice(None)
        return transfer(different, bandwidth, self.clock_mhz, self.order)[position].reshape(
            np.shape(frequency)
        )


def powers(ln_bandwidth: Array) -> Array:
    """Return the powers, from the first, of ln(bandwidth / described bandwidth), shape (n,) -> (n,
    power).
    """
    return ln_bandwidth[:, None] ** np.arange(1, len(NODES_SD) + 1)


def transfer(
    frequency: Array, bandwidth_mhz: float, clock_mhz: float, order: int
) -> NDArray[np.complex128]:
    """Return the complex transfer function of a Butterworth low-pass sampled at the pixel clock,
    linear phase removed.

    Notes
    -----
    Each pixel is held for one clock and sampled at its end, so the sampled response is the
    difference of the step response at whole clocks. The step response is the impulse response's own
    running integral, done numerically.
    """
    taps = _taps(bandwidth_mhz, clock_mhz, order)
    clock = np.arange(len(taps))
    delay = float(np.sum(clock * taps))
    return np.asarray(
        np.exp(-2j * np.pi * np.outer(frequency, clock - delay)) @ taps, np.complex128
    )


@lru_cache(maxsize=64)
def _taps(bandwidth_mhz: float, clock_mhz: float, order: int) -> Array:
    """Return the sampled response at whole clocks, shape (clock,)."""
    fine = 64
    clocks = 40
    omega = 2.0 * np.pi * bandwidth_mhz / clock_mhz
    angles = np.pi * (2.0 * np.arange(order) + order + 1.0) / (2.0 * order)
    poles = omega * np.exp(1j * angles)
    # Impulse response by partial fractions, then its integral over each whole clock.
    time = (np.arange(clocks * fine) + 0.5) / fine
    pole_products = np.array(
        [np.prod(np.delete(pole - poles, index)) for index, pole in enumerate(poles)]
    )
    impulse = np.real((omega**order / pole_products) @ np.exp(np.outer(poles, time)))
    taps = impulse.reshape(clocks, fine).mean(axis=1)
    return taps / taps.sum()
