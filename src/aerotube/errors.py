"""The two ways in which a request can fail."""


class InputError(ValueError):
    """A mistake in what the user asked for; the message says what, where and what to do."""


class ComputationError(RuntimeError):
    """A computation that could not be completed; the message names the beat or run and the reason."""
