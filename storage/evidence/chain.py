"""The chain that a stored value rests on, link by link: scene, frames, rig, calibration, verification, limits, people.

A link that is missing is there by name, and says what would close it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from metrology.errors import StoreError, UsageError
from metrology.kinds import KINDS, Kind
from metrology.requirements import requirements
from metrology.tolerance import PanelSpec
from metrology.verdicts import IN_ORDER
from storage.archive.bundle import MANIFEST, RIG
from storage.archive.files import sha256
from storage.archive.work import NEWEST
from storage.documents import read_json, utc_text
from storage.evidence.rig_facts import RigFacts, rig_facts
from storage.evidence.verifications import Verification, verified
from storage.panel_spec import judged_by
from storage.review import Entry, Feature, Review, ReviewLog

if TYPE_CHECKING:
    from storage.archive.store import Store

Row = Mapping[str, Any]
_MOST_NAMED = 5


@dataclass(frozen=True)
class Link:
    """A link of a chain."""

    name: str
    said: str
    """What it is; where it is missing, why, and what would close it."""
    missing: bool = False


@dataclass(frozen=True)
class Sources:
    """What the chain of a scene is read from."""

    scene: Row
    """Its row of the table scenes."""
    manifest: Mapping[str, Any]
    rig: Mapping[str, Any]
    """manifest, rig: of the run's bundle."""
    manifest_sha256: str
    limits: PanelSpec | None
    """As the run was judged by."""
    verifications: tuple[Verification, ...]
    """Of the rig, the earliest first."""
    decisions: tuple[Entry, ...]
    """What people decided about the scene and its features."""
    review_problem: str | None = None
    """Why the review log cannot be trusted."""


def sources(store: Store, scene_id: str) -> Sources:
    """Read what the chain of a scene rests on."""
    found = store.query("SELECT * FROM scenes WHERE scene_id = ?", [scene_id]).to_pylist()
    for one in sources_of(store, found):
        return one
    raise StoreError(f"{store.root}: found no scene {scene_id!r}, expected a scene_id of the table scenes")


def sources_of(store: Store, scenes: Sequence[Row]) -> Iterator[Sources]:
    """What the chains of some scenes rest on, each given by its row of the table scenes."""
    review = ReviewLog(store.root).of_scenes([scene["scene_id"] for scene in scenes])
    verifications = {rig_id: store.verifications.of_rig(rig_id) for rig_id in {scene["rig_id"] for scene in scenes}}
    for scene in scenes:
        path = store.file(f"{scene['bundle_path']}/{MANIFEST}")
        manifest = read_json(path, StoreError)
        yield Sources(
            scene,
            manifest,
            read_json(store.file(f"{scene['bundle_path']}/{RIG}"), StoreError),
            sha256(path),
            judged_by(manifest, path),
            verifications[scene["rig_id"]],
            tuple(entry for entry in review.entries if entry.scene_id == scene["scene_id"]),
            review.problem,
        )


def trace(store: Store, name: str) -> tuple[Link, ...]:
    """The whole chain of a stored value.

    Parameters
    ----------
    name : str
        ``SCENE_ID/FEATURE_ID``, or the feature's id alone where one scene of the newest ones has such a feature.
    """
    scene_id, kind, row = find(store, name)
    found = sources(store, scene_id)
    feature = Feature(kind.name, kind.id_of(row))
    ends = [decision_link(found, feature, str(row["decision"])), sign_off_link(found)]
    return (value_link(kind, row), *scene_links(found), limits_link(kind, row, found.limits), *ends)


def find(store: Store, name: str) -> tuple[str, Kind, Row]:
    """A feature by its name: its scene, kind and row."""
    scene_id, _, feature = name.rpartition("/")
    found = [
        (kind, row)
        for kind in KINDS
        for row in store.query(
            f"SELECT * FROM {kind.table} WHERE (scene_id = $1 OR $1 = '' AND {NEWEST}) AND {kind.id_sql} = $2",
            [scene_id, feature],
        ).to_pylist()
    ]
    if len(found) == 1:
        kind, row = found[0]
        return row["scene_id"], kind, row
    if found:
        named = ", ".join(f"{row['scene_id']}/{feature}" for _, row in found[:_MOST_NAMED])
        raise UsageError(f"{feature}: found it in {len(found)} scenes, expected one of {named}")
    expected = "a feature such as R12 or J01@24.0" if scene_id else "SCENE_ID/FEATURE_ID, as the tables have them"
    raise UsageError(f"{name}: found no such feature in {store.root}, expected {expected}")


def value_link(kind: Kind, row: Row) -> Link:
    """The values of a feature with their uncertainty, and the verdict."""
    said = []
    for quantity in kind.quantities:
        value, u95 = row[quantity.column], row[quantity.u95_column]
        if value is not None:
            spread = "" if u95 is None else f" ± {u95:.4f}"
            said.append(f"{quantity.said} {value:{'+' if quantity.signed else ''}.4f}{spread} {quantity.unit}")
    verdict = f"{row['decision']}" + (f" ({row['reason']})" if row["reason"] else "")
    if not said:
        return Link(kind.name, f"{kind.id_of(row)}: {verdict}", missing=row["decision"] not in IN_ORDER)
    return Link(kind.name, f"{kind.id_of(row)}: {', '.join(said)}; {verdict}")


def scene_links(found: Sources) -> tuple[Link, ...]:
    """The links that all values of a scene share, from the scan to the limits."""
    scene, manifest = found.scene, found.manifest
    digest, operator = scene["frames_digest"], scene["operator"]
    facts = rig_facts(found.rig)
    versions = ", ".join(f"{name} {version}" for name, version in manifest.get("versions", {}).items())
    return (
        Link("scene", f"{scene['scene_id']}, captured {utc_text(scene['captured_at'])}"),
        _link("operator", operator, "scene.json names nobody; add \"operator\" where scans are captured"),
        _link("frames", digest and f"digest {digest}", "the run is older than digests; inspect the scan again"),
        Link("run", f"{scene['run_id']}, {utc_text(scene['processed_at'])}, manifest SHA-256 {found.manifest_sha256}"),
        Link("rig", f"{scene['rig_id']}, content {scene['rig_hash']}, {_fits(scene)}"),
        _calibration(facts, scene),
        _board(facts),
        verification_link(found),
        _link("software", versions, "the run's manifest names no version"),
        Link("settings", f"{scene['config_hash']} (settings and specification together), all of them in the manifest"),
        _specification(found),
    )  # fmt: skip


def _link(name: str, said: str | None, why_missing: str) -> Link:
    return Link(name, said) if said else Link(name, why_missing, missing=True)


def _fits(scene: Row) -> str:
    rms = scene["epipolar_rms_px"]
    fit = f"fit {scene['rig_verdict'] or 'not judged'}"
    return fit if rms is None else f"{fit}, epipolar RMS {rms:.3f} px"


def _calibration(facts: RigFacts, scene: Row) -> Link:
    if facts.calibrated_at is None:
        return Link("calibration", "the rig file says no time; calibrate the rig", missing=True)
    rms = ", ".join(f"{name} {value:.4f} px" for name, value in facts.rms_px.items())
    said = f"{facts.calibrated_at:%Y-%m-%d}" + (f", reprojection RMS {rms}" if rms else "")
    if facts.due_at is None:
        return Link("calibration", said)
    late = scene["captured_at"] > facts.due_at
    return Link("calibration", f"{said}, due {facts.due_at:%Y-%m-%d}{', overdue at the scan' if late else ''}", late)


def _board(facts: RigFacts) -> Link:
    if facts.certificate is None:
        found = f"{facts.board}, without a certificate" if facts.board else "the rig file names no board"
        return Link("board certificate", f"{found}; state board.certificate in calibration.json", missing=True)
    overdue = facts.calibrated_at is not None and facts.certificate.overdue(facts.calibrated_at)
    late = ", overdue at the calibration" if overdue else ""
    return Link("board certificate", f"{facts.certificate} ({facts.board}){late}", overdue)


def verification_link(found: Sources) -> Link:
    """The verification of the rig that held when the scan was taken."""
    moment = found.scene["captured_at"]
    standing = verified(found.verifications, found.scene["rig_hash"], moment)
    if problem := standing.problem(moment):
        return Link("verification", f"{problem}; flushline verify shows whether the rig measures right", missing=True)
    return Link("verification", standing.last.said if standing.last else "")


def _specification(found: Sources) -> Link:
    document = found.manifest.get("panel_spec") or {}
    if document.get("example"):
        said = "the example limits, which are nobody's requirement; give the panel's"
        return Link("specification", said, missing=True)
    return _link("specification", found.scene["panel_spec"], "none was given")


def limits_link(kind: Kind, row: Row, spec: PanelSpec | None) -> Link:
    """The limits that a feature was judged by, each with its source and revision."""
    if spec is None:
        return Link("limits", "the run keeps none that this version can read", missing=True)
    known = {field.name for field in fields(kind.row_type)}
    feature = kind.row_type(**{name: value for name, value in row.items() if name in known})
    asked = [required for required in requirements(kind, feature, spec) if required.limit]
    said = "; ".join(f"{required.name} {required.limit} {required.unit}" for required in asked)
    return _link("limits", said and f"zone {row['zone'] or 'default'}: {said}", "the specification asks nothing of it")


def decision_link(found: Sources, feature: Feature, verdict: str) -> Link:
    """What a person decided about a feature; it needs a decision where it does not pass."""
    if found.review_problem:
        return Link("decision", found.review_problem, missing=True)
    about = Review(found.decisions).held(str(found.scene["scene_id"]), feature)
    if about:
        comment = f": {about[-1].comment}" if about[-1].comment else ""
        return Link("decision", f"{about[-1].said}{comment} (entry {about[-1].number}, {about[-1].checksum[:12]}…)")
    if verdict in IN_ORDER:
        return Link("decision", f"none needed: {verdict}")
    return Link("decision", f"{verdict}, and nobody decided; see the dashboard's review", missing=True)


def sign_off_link(found: Sources) -> Link:
    """Who signed the scene off."""
    if found.review_problem:
        return Link("sign-off", found.review_problem, missing=True)
    signed = [entry for entry in found.decisions if entry.action == "sign-off"]
    if not signed:
        return Link("sign-off", "the scene is open; sign it off in the dashboard", missing=True)
    last = signed[-1]
    stays = "" if last.run_id == found.scene["run_id"] else f" on another run ({last.run_id})"
    return Link("sign-off", f"{last.said}{stays} (entry {last.number}, {last.checksum[:12]}…)", bool(stays))


def missing(links: Sequence[Link]) -> list[str]:
    """The names of links that are missing."""
    return [link.name for link in links if link.missing]
