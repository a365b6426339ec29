"""The errors of relax: each message is one sentence that says what was found, where, what was expected and what to do."""


class RelaxError(Exception):
    """Anything that relax refuses or cannot do; the message is meant for the person who asked."""


class StopRun(KeyboardInterrupt):
    """Raised by a callback to end a run: as after Ctrl-C, the best so far is the answer, and its `stop` says who ended it."""


class InputError(RelaxError, ValueError):
    """A scene, a result or an argument that cannot be used."""


class EquilibriumError(RelaxError, ArithmeticError):
    """No equilibrium was found, or the one that was found does not stand."""


class BackendError(RelaxError, RuntimeError):
    """A back-end cannot take a convex step, or did not solve it."""


class UnheldError(BackendError):
    """The answer of a convex step leaves a part of the membrane without a fixed vertex unheld."""


class UnsupportedError(BackendError, InputError):
    """A back-end lacks what this kind of problem needs; the message says what, and who can."""
