"""Parameters of a penalty: dataclass fields that say which numbers they may be, in Python and in scene files alike."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from math import inf
from typing import Annotated, Any, get_type_hints

from relax.errors import InputError


@dataclass(frozen=True)
class Numbers:
    """The numbers that a parameter may be, in words and as a test."""

    words: str
    allows: Callable[[float], bool]


Force = Annotated[float, Numbers("a number above 0, newtons", lambda force: 0 < force < inf)]


def parameters(kind: type[Any]) -> Mapping[str, Numbers]:
    """The parameters of a penalty's class in their order: fields of the type Annotated[float, Numbers(...)]."""
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name].__metadata__[0] for field in fields(kind)}


def check_parameters(penalty: Any) -> None:
    """Refuse a parameter that is out of its range: what a penalty does when it is made."""
    for name, numbers in parameters(type(penalty)).items():
        value = getattr(penalty, name)
        if not numbers.allows(value):
            raise InputError(f"penalty.{name} is {value}: expected {numbers.words}")
