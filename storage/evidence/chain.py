"""The chain that a stored value rests on, link by link: scene, frames, rig, calibration, verification, limits, people.

A link that is missing is there by name, and says what would close it. What a link says is in the language that is
written in (`storage.wording`); names of links, values, times and checksums are the same in all languages.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from typing import TYPE_CHECKING, Any

from metrology.errors import StoreError, UsageError
from metrology.kinds import KINDS, Kind
from metrology.requirements import requirements
from metrology.tolerance import PanelSpec
from metrology.verdicts import IN_ORDER
from storage.archive.bundle import MANIFEST, RIG
from storage.archive.files import sha256
from storage.archive.work import NEWEST
from storage.certificate import CertificateModel
from storage.documents import read_json, utc_text
from storage.evidence.rig_facts import RigFacts, rig_facts
from storage.evidence.verifications import Verification, verified
from storage.panel_spec import judged_by
from storage.review import Entry, Feature, Review, ReviewLog
from storage.review_details import remarks
from storage.wording import N_, _, decimals, reason

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
    scene_id, __, feature = name.rpartition("/")
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
        named = ", ".join(f"{row['scene_id']}/{feature}" for __, row in found[:_MOST_NAMED])
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
    captured, stored = utc_text(scene["captured_at"]), utc_text(scene["processed_at"])
    run = _("{run}, {time}, manifest SHA-256 {sum}", run=scene["run_id"], time=stored, sum=found.manifest_sha256)
    rig = _("{rig}, content {hash}, {fit}", rig=scene["rig_id"], hash=scene["rig_hash"], fit=_fits(scene))
    settings = _("{hash} (settings and specification together), all of them in the manifest", hash=scene["config_hash"])
    nobody = _('scene.json names nobody; add "operator" where scans are captured')
    too_old = _("the run is older than digests; inspect the scan again")
    return (
        Link(N_("scene"), _("{scene}, captured {time}", scene=scene["scene_id"], time=captured)),
        _link(N_("operator"), operator, nobody),
        _link(N_("frames"), digest and _("digest {digest}", digest=digest), too_old),
        Link(N_("run"), run),
        Link(N_("rig"), rig),
        _calibration(facts, scene),
        _board(facts),
        verification_link(found),
        _link(N_("software"), versions, _("the run's manifest names no version")),
        Link(N_("settings"), settings),
        _specification(found),
    )


def _link(name: str, said: str | None, why_missing: str) -> Link:
    return Link(name, said) if said else Link(name, why_missing, missing=True)


def _fits(scene: Row) -> str:
    rms = scene["epipolar_rms_px"]
    fit = _("fit: {verdict}", verdict=_(scene["rig_verdict"] or N_("not judged")))
    if rms is None:
        return fit
    off = decimals(f"{rms:.3f}")
    return f"{fit}, " + _("epipolar RMS {rms} px", rms=off)


def _day(moment: datetime) -> str:
    return f"{moment:%Y-%m-%d}"


def _calibration(facts: RigFacts, scene: Row) -> Link:
    name = N_("calibration")
    if facts.calibrated_at is None:
        return Link(name, _("the rig file says no time; calibrate the rig"), missing=True)
    rms = decimals(", ".join(f"{device} {value:.4f} px" for device, value in facts.rms_px.items()))
    said = _day(facts.calibrated_at) + (", " + _("reprojection RMS {rms}", rms=rms) if rms else "")
    if facts.due_at is None:
        return Link(name, said)
    late = scene["captured_at"] > facts.due_at
    due = _("due {day}", day=_day(facts.due_at))
    return Link(name, f"{said}, {due}" + (", " + _("overdue at the scan") if late else ""), late)


def _board(facts: RigFacts) -> Link:
    name = N_("board certificate")
    if facts.certificate is None:
        none = _("{board}, without a certificate", board=facts.board) if facts.board else ""
        found = none or _("the rig file names no board")
        return Link(name, f"{found}; " + _("state board.certificate in calibration.json"), missing=True)
    overdue = facts.calibrated_at is not None and facts.certificate.overdue(facts.calibrated_at)
    late = ", " + _("overdue at the calibration") if overdue else ""
    return Link(name, f"{_certificate(facts.certificate)} ({facts.board}){late}", overdue)


def _certificate(found: CertificateModel) -> str:
    """Number, laboratory and until when it holds."""
    said = _("{number} of {laboratory}", number=found.number, laboratory=found.laboratory) if found.laboratory else ""
    due = _("due {day}", day=_day(found.due_at)) if found.due_at else _("without a due date")
    return f"{said or found.number}, {due}"


def verification_link(found: Sources) -> Link:
    """The verification of the rig that held when the scan was taken."""
    name, moment = N_("verification"), found.scene["captured_at"]
    standing = verified(found.verifications, found.scene["rig_hash"], moment)
    if problem := standing.problem(moment):
        shows = _("flushline verify shows whether the rig measures right")
        return Link(name, f"{reason(problem)}; {shows}", missing=True)
    return Link(name, _verified(standing.last) if standing.last else "")


def _verified(last: Verification) -> str:
    """Verdict, when and with what, in one line."""
    m = last.model
    certificate = _("certificate {certificate}", certificate=_certificate(m.artefact.certificate)) if (
        m.artefact.certificate
    ) else _("without a certificate")  # fmt: skip
    artefact = f"{m.artefact.kind} {m.artefact.id}"
    said = _(
        "{verdict} on {day} by {artefact} ({certificate})", verdict=_(m.verdict), day=_day(m.verified_at),
        artefact=artefact, certificate=certificate,
    )  # fmt: skip
    due = ", " + _("next due {day}", day=_day(m.due_at)) if m.due_at else ""
    return f"{said}{due}; {last.name}"


def _specification(found: Sources) -> Link:
    name, document = N_("specification"), found.manifest.get("panel_spec") or {}
    if document.get("example"):
        said = _("the example limits, which are nobody's requirement; give the panel's")
        return Link(name, said, missing=True)
    return _link(name, found.scene["panel_spec"], _("none was given"))


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
        said = remarks(about[-1], _, reason)
        comment = f": {said}" if said else ""
        return Link("decision", f"{about[-1].said}{comment} (entry {about[-1].number}, {about[-1].checksum[:12]}…)")
    if verdict in IN_ORDER:
        return Link("decision", f"none needed: {verdict}")
    return Link("decision", f"{verdict}, and nobody decided; see the dashboard's review", missing=True)


def sign_off_link(found: Sources) -> Link:
    """Who signed the scene off."""
    name = N_("sign-off")
    if found.review_problem:
        return Link(name, found.review_problem, missing=True)
    signed = [entry for entry in found.decisions if entry.action == "sign-off"]
    if not signed:
        return Link(name, _("the scene is open; sign it off in the dashboard"), missing=True)
    last = signed[-1]
    other = last.run_id != found.scene["run_id"]
    said = _("{what} by {who} at {time}", what=_(last.what), who=last.who, time=utc_text(last.at))
    said += f" ({last.signature.role})" if last.signature else ""
    stays = " " + _("on another run ({run})", run=last.run_id) if other else ""
    entry = _("entry {number}, {sum}…", number=last.number, sum=last.checksum[:12])
    return Link(name, f"{said}{stays} ({entry})", other)


def missing(links: Sequence[Link]) -> list[str]:
    """The names of links that are missing."""
    return [link.name for link in links if link.missing]
