"""One comparison of measured with simulated frames."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Statistic:
    """One comparison of measured with simulated frames.

    Parameters
    ----------
    name, title, note
        Short name, description, and note for the reader.
    distance
        Distance of the measured value from the simulated ones, about 1 if they agree.
    p_value, level
        Probability of a distance at least as large if the camera is right, and that below which it
        fails, corrected for several comparisons; dimensionless. The probability of a number that
        cannot be measured is 0.
    least_p
        Least p-value that the number of repetitions can give.
    labels, measured, low95, high95
        Names of the numbers, measured values, and predicted 95 % intervals.
    worst, cause
        Number that deviates most, and stages or faults that move the numbers of this statistic.
    """

    name: str
    title: str
    distance: float
    p_value: float
    level: float
    labels: tuple[str, ...] = ()
    measured: tuple[float, ...] = ()
    low95: tuple[float, ...] = ()
    high95: tuple[float, ...] = ()
    note: str = ""
    least_p: float = 0.0
    worst: str = ""
    cause: str = ""

    @property
    def passed(self) -> bool:
        """Whether the measured frames look like the simulated ones in this respect."""
        return self.p_value >= self.level

    @property
    def p_text(self) -> str:
        """The p-value, or "< least" where no repetition was as distant."""
        return (
            f"< {self.least_p:.2g}"
            if self.p_value <= self.least_p * 1.0001
            else f"{self.p_value:.2g}"
        )
