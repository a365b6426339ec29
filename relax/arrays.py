"""Array types, and the lock that keeps the values of this package from changing under a reader."""

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


def lock_arrays(value: Any) -> None:
    """Replace the array fields of a frozen dataclass by read-only views: values never change under a reader.

    Numbers of another precision become doubles: forces of single precision would never balance to 1e-10.
    """
    for field in fields(value):
        array = getattr(value, field.name)
        if isinstance(array, np.ndarray):
            view = (array.astype(np.float64, copy=False) if array.dtype.kind == "f" else array).view()
            view.flags.writeable = False
            object.__setattr__(value, field.name, view)
