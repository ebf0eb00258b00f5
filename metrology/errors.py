"""Domain errors. Each message is one line a user can act on: which input, what was found, what was expected."""

from __future__ import annotations


class FlushlineError(Exception):
    """Base of every error that is the input's or the user's to mend; the command line prints it without a traceback."""


class UsageError(FlushlineError):
    """A command or a setting that makes no sense."""


class SceneError(FlushlineError):
    """A scene folder that cannot be inspected: missing, damaged or contradictory."""


class RigError(FlushlineError):
    """A rig file that is damaged, or a rig that does not fit the scan."""


class CalibrationError(FlushlineError):
    """A calibration capture from which no trustworthy rig follows."""


class SpecError(FlushlineError):
    """A panel specification or a simulation specification that is wrong."""


class StoreError(FlushlineError):
    """A store that is damaged, absent, or asked for what it does not hold."""


class OutdatedError(UsageError):
    """A decision about something that is not any more what the person had before them."""
