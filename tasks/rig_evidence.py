"""Whether a rig's verification and calibration held when a scan was taken."""

from __future__ import annotations

from datetime import datetime

from metrology.errors import RigError, StoreError
from metrology.rig import Rig
from storage.archive import Store
from storage.archive.bundle import document_hash
from storage.evidence.rig_facts import rig_facts
from storage.evidence.verifications import verified
from storage.rig import rig_document
from tasks.settings import VerificationSettings


def evidence_warnings(
    store: Store, rig: Rig, captured_at: datetime, settings: VerificationSettings, place: object
) -> list[str]:
    """What is to be said of a rig whose verification failed, is overdue or is lacking, or whose calibration is overdue.

    Parameters
    ----------
    place : object
        Names the scan in errors.

    Raises
    ------
    RigError
        In place of warnings, where the settings say so.
    """
    found = [f"rig {rig.id}: {problem}" for problem in _problems(store, rig, captured_at, settings)]
    if found and settings.refuse:
        raise RigError(
            f"{place}: found {'; '.join(found)}, expected a rig whose verification and calibration held; "
            "flushline verify shows whether it measures right"
        )
    return found


def _problems(store: Store, rig: Rig, captured_at: datetime, settings: VerificationSettings) -> list[str]:
    document = rig_document(rig)
    found = []
    due = rig_facts(document).due_at
    if due and captured_at > due:
        found.append(f"calibration overdue since {due:%Y-%m-%d}")
    try:
        known = store.verifications.of_rig(rig.id)
    except StoreError as problem:
        return [*found, f"verifications cannot be read ({problem})"]
    if not known and not settings.required:
        return found
    standing = verified(known, document_hash(document), captured_at)
    # Scans from before the first verification are none of its business, unless one is required.
    if standing.last is None and not settings.required and not standing.other_calibration:
        return found
    said = standing.problem(captured_at)
    return [*found, said] if said else found
