"""Are the rigs and patterns that a store lends to later scans still those that scans were inspected with?

Each run's manifest has the hash of its rig, and the checksum of the pattern that it enrolled. A pattern that a person
enrolled from a stored scan ends with a line that has its checksum.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from hashlib import sha256

from metrology.errors import FlushlineError
from storage.archive.bundle import PATTERN, BundleModel, document_hash
from storage.archive.layout import Layout
from storage.archive.panels import SEAL
from storage.panel_spec import load_panel_spec
from storage.rig import load_rig, rig_document


def kept_problems(layout: Layout, manifests: Collection[BundleModel]) -> Iterator[str]:
    """Rigs and patterns that are not as the store's undamaged runs noted them, one line each."""
    yield from _rig_problems(layout, manifests)
    yield from _pattern_problems(layout, manifests)


def _rig_problems(layout: Layout, manifests: Collection[BundleModel]) -> Iterator[str]:
    used: dict[str, set[str]] = {}
    for manifest in manifests:
        if manifest.rig_hash:
            used.setdefault(manifest.rig, set()).add(manifest.rig_hash)
    for path in sorted(layout.rigs.glob("*.json")):
        try:
            hashes = {document_hash(json.loads(path.read_text())), document_hash(rig_document(load_rig(path)))}
        except (FlushlineError, OSError, ValueError) as problem:
            yield f"{path}: found {str(problem).splitlines()[0]}, expected a rig"
            continue
        if path.stem in used and not used[path.stem] & hashes:
            yield (
                f"{path}: found other values than every run with rig {path.stem} was made with, expected one of "
                "theirs: the file was altered; each bundle has the rig it was made with in rig.json"
            )


def _pattern_problems(layout: Layout, manifests: Collection[BundleModel]) -> Iterator[str]:
    enrolled: dict[str, set[str]] = {}
    for manifest in manifests:
        if PATTERN in manifest.files:
            enrolled.setdefault(manifest.scene_id, set()).add(manifest.files[PATTERN].sha256)
    for path in sorted(layout.panels.glob("*/enrolled/*.toml")):
        content = path.read_bytes()
        body, seal, digest = content.rpartition(SEAL)
        if seal:
            altered = sha256(body).hexdigest() != digest.strip().decode(errors="replace")
        else:
            try:
                known = enrolled.get(str(load_panel_spec(path).document.get("enrolled_from")), set())
            except FlushlineError as problem:
                yield f"{path}: found {str(problem).splitlines()[0]}, expected a pattern"
                continue
            altered = bool(known) and sha256(content).hexdigest() not in known
        if altered:
            yield (
                f"{path}: found other content than was enrolled, expected it unchanged: scans are recognised and named "
                "by it; 'flushline panel enrol SCENE_ID --replace' takes a scan's pattern anew"
            )
