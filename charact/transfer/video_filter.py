"""Video filter: causal low-pass along the rows with an uncertain bandwidth."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.transfer.form import Parameter, flat_parameters
from labdata import Array
from labdata.camera.description import Camera, has_tube

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
        weights = sampled_response(np.array([bandwidth]), self.clock_mhz, self.order)
        return transfer(weights, different)[0, position].reshape(np.shape(frequency))


@dataclass(frozen=True, kw_only=True)
class PixelAndVideo:
    """Known part of a transfer: |sinc(fx) sinc(h fy)| |V(fx)|, pixel and video filter.

    Parameters
    ----------
    height_px
        Height h of a pixel as read, column pitches; its width is one.
    video
        Filter V along the rows, or None.
    """

    height_px: float = 1.0
    video: VideoFilter | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The video's bandwidth where it is known within a range only."""
        if self.video is None:
            return ()
        return tuple(
            replace(bandwidth, sd=self.video.ln_bandwidth_sd, start=0.0)
            for bandwidth in flat_parameters(self.video.parameters)
        )

    def bend(self, fx: Array) -> Array | None:
        """Return how ln of the modulus moves with the video's bandwidth, see `VideoFilter.bend`;
        None: it is exact.
        """
        return self.video.bend(fx).real if self.video and self.video.parameters else None

    def electronics(self, fx: Array) -> Array:
        """Return |V| of the described video; it acts on pixels, so it has no replicas."""
        return np.ones_like(fx) if self.video is None else np.abs(self.video(fx))

    def aperture(self, fx: Array, fy: Array) -> Array:
        """Return |sinc sinc| at frequencies along rows and columns, cycles per column pitch."""
        return np.abs(np.sinc(fx) * np.sinc(fy * self.height_px))

    def __call__(self, fx: Array, fy: Array) -> Array:
        """Return the modulus at frequencies along rows and columns, cycles per column pitch."""
        return self.aperture(fx, fy) * self.electronics(fx)


def powers(ln_bandwidth: Array) -> Array:
    """Return the powers, from the first, of ln(bandwidth / described bandwidth), shape (n,) -> (n,
    power).
    """
    return ln_bandwidth[:, None] ** np.arange(1, len(NODES_SD) + 1)


def sampled_response(bandwidth_mhz: Array, clock_mhz: float, order: int, clocks: int = 40) -> Array:
    """Return the weights of earlier pixels in one pixel, shape (n, clock), with sum 1.

    Parameters
    ----------
    bandwidth_mhz
        Frequency of 3 dB loss, shape (n,), MHz.
    clock_mhz, order
        Pixel clock, MHz, and order of the Butterworth filter.
    clocks
        Number of weights.

    Notes
    -----
    Poles p_k = w exp(i pi (2k + order + 1)/(2 order)); step response s(t) = 1 + sum_k r_k exp(p_k
    t)/p_k with the residues r_k = w^order / prod_{j != k} (p_k - p_j). Each pixel is held for one
    clock and sampled at its end: a step that begins j clocks before the sampled pixel has risen to
    s(j + 1) and, with its successor, contributes s(j + 1) - s(j).
    """
    unit = np.exp(1j * np.pi * (2.0 * np.arange(order) + order + 1.0) / (2.0 * order))
    differences = np.where(np.eye(order, dtype=bool), 1.0, unit[:, None] - unit[None, :])
    residue_over_pole = 1.0 / (differences.prod(axis=1) * unit)
    omega = 2.0 * np.pi * np.asarray(bandwidth_mhz, float) / clock_mhz
    time = np.arange(clocks) + 1.0
    rise = np.exp(unit[None, :, None] * omega[:, None, None] * time)
    step = 1.0 + np.einsum("k,nkt->nt", residue_over_pole, rise).real
    weights = np.diff(step, axis=1, prepend=0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def transfer(weights: Array, frequency: Array) -> NDArray[np.complex128]:
    """Return the complex transfer function of weights of earlier pixels, linear phase removed,
    shape (n, clock) and (f,) -> (n, f).
    """
    clock = np.arange(weights.shape[1])
    delay = (weights @ clock)[:, None]
    turns = np.exp(-2j * np.pi * np.outer(clock, frequency))
    return (weights @ turns) * np.exp(2j * np.pi * delay * frequency)
