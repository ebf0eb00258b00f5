"""Registration: what a scan found, recognised as the rivets and seams of its panel (docs/panels.md)."""

from metrology.registration.doubts import enrolment_doubts
from metrology.registration.enrol import enrol
from metrology.registration.register import Registration, RegistrationSettings, register, with_others

__all__ = ["Registration", "RegistrationSettings", "enrol", "enrolment_doubts", "register", "with_others"]
