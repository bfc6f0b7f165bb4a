"""The ranges of the quantities in files: what is beyond them is a slip of the hand.

A field's quantity is known by the unit at the end of its name, so that a new field has its range.
A field that states both of its bounds keeps those.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic_core import PydanticCustomError

# No amount that has to be above 0 is smaller.
LEAST = 1e-30


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity with the largest amount of it in a file, either way.

    Args:
        most: largest amount, in the unit.
        unit: for people; empty: a number without a unit.
        why: the bound in words.
    """

    most: float
    unit: str
    why: str

    def within(self, value: float) -> float:
        """Return a value that is within the range; NaN never is.

        Raises:
            PydanticCustomError: it isn't.
        """
        if -self.most <= value <= self.most:
            return value
        unit = f" {self.unit}" if self.unit else ""
        raise PydanticCustomError(
            "out_of_range", f"must be from -{self.most:.12g} to {self.most:.12g}{unit}, {self.why}"
        )

    def within_positive(self, value: float) -> float:
        """Return a value as ``within`` does, of a field whose amount is above 0."""
        if value < LEAST:
            raise PydanticCustomError("out_of_range", f"must be {LEAST:g} or more")
        return self.within(value)


LENGTH = Quantity(1e8, "m", "farther than any two places on the Earth")
NUMBER = Quantity(1e12, "", "the largest number of a file")

# By the end of a field's name; of two ends that fit, the first counts.
QUANTITIES = {
    "_per_m": Quantity(10.0, "1/m", "the densest"),
    "_per_s": Quantity(1000.0, "1/s", "the most often"),
    "_mps2": Quantity(1000.0, "m/s^2", "a hundred times gravity"),
    "_mps": Quantity(350.0, "m/s", "about the speed of sound"),
    "_radps": Quantity(100.0, "rad/s", "16 turns a second"),
    "_rad": Quantity(1000.0, "rad", "160 turns"),
    "_deg": Quantity(360.0, "deg", "a whole turn"),
    "_1pm": Quantity(100.0, "1/m", "a radius of 1 cm"),
    "_hz": Quantity(10_000.0, "Hz", "the fastest"),
    "_px": Quantity(100_000.0, "px", "the largest picture"),
    "_b": Quantity(1e6, "billions", "the largest model"),
    "_s": Quantity(86_400.0, "s", "a day"),
    "_m": LENGTH,
}


def of_unit(unit: str) -> Quantity:
    """Return the quantity of a unit as people write it."""
    return next((one for one in QUANTITIES.values() if one.unit == unit), NUMBER)


def quantity_of(name: str) -> Quantity:
    """Return the quantity of a field by the unit at the end of its name."""
    return next((one for end, one in QUANTITIES.items() if name.endswith(end)), NUMBER)
