"""Gain sweeps of exactly known law, knee and saturation, drawn as statistics: how often the
intervals hold.

`python -m benchmarks.studies.gain_sweeps` draws a thousand sweeps and prints, for every quantity,
in how many of those that gave a number its 95 % interval held the truth. Truths are closed forms;
no frame and no simulator takes part.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.sweep.settings import KNOBS, Sweep, SweepSetting
from charact.estimators.noise.sweep.sweep import measure_sweep
from charact.method import Context
from labdata import Result

Array = NDArray[np.float64]

DRAWS = 1000
# An ok number further from the truth than so many arms of its 95 % interval is a silent failure.
SILENT = 2.0


@dataclass(frozen=True, kw_only=True)
class SweepScene:
    """A tube of known law before a camera of known noise.

    Parameters
    ----------
    volts
        Settings, V.
    lights
        Light of the flats of every setting, photons on a pixel.
    exponent, pulses_dn
        Law of the pulses' covariance gain, pulses_dn (V/800)^exponent, DN.
    excess
        Exponent with which F^2 falls as the voltage rises.
    departure, scatter
        Relative standard deviation of settings about the law and of levels about the response.
    electron_gain_dn
        K, DN.
    blur, blur_scatter
        Share of the pulses' covariance left in the variance, and how far it differs between
        settings.
    photons_per_pe
        Photons for each photoelectron.
    saturation_dn
        Signal towards which a tired plate bends the response, DN.
    read_noise_dn, dark_pe
        Read noise, and photoelectrons (as noise counts them) on a pixel in the dark.
    covariance_sd, shared_sd, variance_sd
        Relative errors of each covariance gain, of all of them in common, and of the variances.
    """

    volts: tuple[float, ...] = (620.0, 660.0, 700.0, 750.0, 800.0, 850.0)
    lights: tuple[float, ...] = (10.0, 30.0, 90.0)
    exponent: float = 10.0
    pulses_dn: float = 40.0
    excess: float = 0.5
    departure: float = 0.02
    scatter: float = 0.005
    electron_gain_dn: float = 0.05
    blur: float = 0.2
    blur_scatter: float = 0.01
    photons_per_pe: float = 3.0
    saturation_dn: float = 5000.0
    read_noise_dn: float = 2.0
    dark_pe: float = 0.02
    covariance_sd: float = 0.03
    shared_sd: float = 0.02
    variance_sd: float = 0.004

    def truths(self) -> dict[str, float]:
        """The law's own numbers, by quantity and unit."""
        sum_, product = (
            (1.0 + self.blur) * self.electron_gain_dn,
            self.electron_gain_dn**2 - self.read_noise_dn**2,
        )
        knee = (-sum_ + np.sqrt(sum_**2 - 4.0 * self.blur * product)) / (2.0 * self.blur)
        return {
            "gain_exponent 1": self.exponent,
            "gain_knee V": 800.0
            * float(knee / self.pulses_dn) ** (1.0 / (self.exponent - self.excess)),
            "gain_knee DN": float(knee) + self.electron_gain_dn,
            "mcp_saturation DN": self.saturation_dn,
        }

    def drawn(self, rng: np.random.Generator, *, lit: bool = True) -> tuple[Sweep, Array, Array]:
        """Draw a sweep; return it with the true covariance gain and F^2 (in proportion) of each
        setting.
        """
        volts = np.array(self.volts)
        departs = self.departure * rng.standard_normal(len(volts))
        gain = self.pulses_dn * (volts / 800.0) ** self.exponent * np.exp(departs)
        factor = (volts / 800.0) ** -self.excess
        pulses, shared = gain * factor, self.shared_sd * rng.standard_normal()
        settings = tuple(
            self._setting(v, g, p, shared, lit, rng)
            for v, g, p in zip(volts, gain, pulses, strict=True)
        )
        return (
            Sweep(knob=KNOBS[0], settings=settings, main=800.0),
            pulses + self.electron_gain_dn,
            factor,
        )

    def _setting(
        self,
        volts: float,
        gain: float,
        pulses: float,
        shared: float,
        lit: bool,
        rng: np.random.Generator,
    ) -> SweepSetting:
        """Statistics of one setting."""
        light = np.array(self.lights)
        untired = gain / 2.0 * light / self.photons_per_pe
        signal = (
            untired
            / (1.0 + untired / self.saturation_dn)
            * np.exp(self.scatter * rng.standard_normal(light.size))
        )
        covariance = pulses + self.electron_gain_dn
        seen = np.log(covariance) + shared + self.covariance_sd * rng.standard_normal()
        error = float(np.hypot(self.covariance_sd, self.shared_sd))
        blur = self.blur * np.exp(self.blur_scatter * rng.standard_normal())
        variance = blur * pulses + self.electron_gain_dn
        # What the plate loses shows in the noise, which was carried to small signals where the
        # light is unknown.
        left = 1.0 - float(signal.mean()) / self.saturation_dn if lit else 1.0
        levels = covariance * (1.0 - signal / self.saturation_dn)
        dark = self.read_noise_dn**2 + variance * covariance * self.dark_pe
        drawn = left * np.exp(seen + error * rng.standard_normal(DRAWS))
        return SweepSetting(
            value=float(volts),
            labels=tuple(f"{volts:g} V, {value:g}" for value in light),
            gain_dn=drawn,
            log_variance=float(np.log(left * variance) + self.variance_sd * rng.standard_normal()),
            log_variance_sd=self.variance_sd,
            blur_factor=left * variance / drawn,
            white=False,
            light=light if lit else None,
            light_unit="photon",
            light_relative_sd=0.0,
            signal_dn=signal,
            signal_sd_dn=1e-4 * signal,
            levels_dn=levels + 0.01 * covariance * rng.standard_normal(light.size),
            levels_sd_dn=np.full(light.size, 0.01 * covariance),
            variance_dn2=signal * variance,
            dark_variance_dn2=dark * (1.0 + 0.005 * rng.standard_normal()),
            dark_variance_sd_dn2=0.005 * dark,
            dark=f"dark, {volts:g} V",
        )


def scene_drawn(rng: np.random.Generator) -> SweepScene:
    """Draw a scene: departures and scatter from what the analysis takes for usual, all else from
    wide ranges.
    """
    pulses = float(rng.uniform(25.0, 60.0))
    exponent = float(rng.uniform(8.0, 12.0))
    least = pulses * (620.0 / 800.0) ** exponent
    scene = SweepScene(
        exponent=exponent,
        pulses_dn=pulses,
        excess=float(rng.uniform(0.0, 0.6)),
        departure=abs(0.05 * rng.standard_normal()),
        scatter=abs(0.03 * rng.standard_normal()),
        electron_gain_dn=least * min(abs(0.05 * rng.standard_normal()), 0.15),
        blur=float(rng.uniform(0.15, 0.6)),
        blur_scatter=0.02,
    )
    brightest = pulses * (850.0 / 800.0) ** exponent / 2.0 * scene.lights[-1] / scene.photons_per_pe
    return replace(scene, saturation_dn=brightest * float(np.exp(rng.uniform(0.0, 4.0))))


def covered(count: int, seed: int, *, lit: bool = True) -> Iterator[tuple[str, float, str]]:
    """Draw sweeps and yield for every number its name, its error over its 95 % arm on that side,
    and its status.
    """
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        scene = scene_drawn(rng)
        sweep, gain, factor = scene.drawn(rng, lit=lit)
        result = measure_sweep(sweep, context=Context(seed=index, quick=True))
        truth = scene.truths()
        if not lit:
            # Without light the law is that of the covariance gain, F^2 included.
            truth["gain_exponent 1"] -= scene.excess
        yield from _held(result, truth, sweep, gain, factor)


def _held(
    result: Result, truth: dict[str, float], sweep: Sweep, gain: Array, factor: Array
) -> Iterator[tuple[str, float, str]]:
    """Every number of a result against its truth."""
    of_stack = {s.stack: i for i, s in enumerate(sweep.settings)}
    # F^2 is stated over that of the one setting that has none of its own.
    stated = {m.stack for m in result.find("relative_excess_noise_factor")}
    reference = next(
        f for s, f in zip(sweep.settings, factor, strict=True) if s.stack not in stated
    )
    for m in result.measurements:
        name = f"{m.quantity} {m.unit}"
        true = truth.get(name)
        if m.quantity == "covariance_gain" and m.stack is not None:
            true = float(gain[of_stack[m.stack]])
        if m.quantity == "relative_excess_noise_factor" and m.stack is not None:
            true = float(factor[of_stack[m.stack]] / reference)
        if true is None or m.value is None or m.interval95 is None:
            continue
        arm = m.interval95[1] - m.value if true > m.value else m.value - m.interval95[0]
        yield name, abs(true - m.value) / max(arm, 1e-300), m.status


def main(count: int = 1000) -> None:
    """Print how often intervals hold, with and without recorded light."""
    for lit in (True, False):
        told: dict[str, list[tuple[float, str]]] = defaultdict(list)
        for name, off, status in covered(count, 1, lit=lit):
            told[name].append((off, status))
        print(f"\n{count} sweeps, light {'recorded' if lit else 'unknown'}")
        for name, of in told.items():
            every, trusted = (
                np.array([off for off, _ in of]),
                np.array([off for off, status in of if status == "ok"]),
            )
            held, silent = 100.0 * np.mean(trusted <= 1.0), int(np.sum(trusted > SILENT))
            print(
                f"{name:32} {len(every):5} numbers hold {100.0 * np.mean(every <= 1.0):5.1f} %, "
                f"{len(trusted):5} ok ones {held:5.1f} %, {silent} silent failures"
            )


if __name__ == "__main__":
    main()
