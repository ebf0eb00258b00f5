"""QIF 3.0: features, characteristics with limits, measured values with uncertainties, and their statistics."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from datetime import UTC
from itertools import count, groupby
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from metrology.results import COVERAGE_95, Decision
from metrology.verdicts import DECISIONS
from storage.documents import utc_text
from storage.export.formats import Place
from storage.export.qif_statistics import statistics
from storage.export.subject import Characteristic, ExportedScene, Subject, stable_uuid

NAMESPACE = "http://qifstandards.org/xsd/qif3"
# XML cannot hold these, not even escaped.
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

FAMILY = {"mm": "UserDefinedLinear", "°": "UserDefinedAngular"}
"""QIF's kind of characteristic, by the unit of a quantity."""
_BY_TONE = {"good": "PASS", "fair": "PASS", "doubtful": "FAIL", "bad": "FAIL", "none": "NOT_ANALYZED"}
STATUS: dict[Decision, str] = {decision: _BY_TONE[look.tone] for decision, look in DECISIONS.items()}
"""CharacteristicStatusEnum, by the decision; the decision itself is the attribute `decision` of the measurement."""
INSPECTION = {"PASS": "PASS", "FAIL": "FAIL", "NOT_ANALYZED": "NOT_MEASURED"}
_UNITS = (
    "<FileUnits><PrimaryUnits>"
    "<AngularUnit><SIUnitName>radian</SIUnitName><UnitName>degree</UnitName>"
    "<UnitConversion><Factor>0.017453292519943</Factor></UnitConversion></AngularUnit>"
    "<LinearUnit><SIUnitName>meter</SIUnitName><UnitName>mm</UnitName>"
    "<UnitConversion><Factor>0.001</Factor></UnitConversion></LinearUnit>"
    "</PrimaryUnits></FileUnits>"
)
_MEASURED = "<DeterminationMode><Checked><CheckDetails><Measured/></CheckDetails></Checked></DeterminationMode>"
_STANDARD, _PART, _COMPONENT = 1, 2, 3


def write(subject: Subject, place: Place) -> list[Path]:
    """One document of Results and Statistics."""
    path = place.file(".qif")
    path.write_text(document(subject), encoding="utf-8")
    return [path]


def document(subject: Subject) -> str:
    """The document of a subject.

    Ids are whole numbers within the document; what is to be found again in another one has a UUID that follows from
    what it names.
    """
    ids = count(_COMPONENT + 1)
    features = _Features(subject, ids)
    characteristics = _Characteristics(subject.characteristics, features, ids)
    devices = {rig: next(ids) for rig in dict.fromkeys(scene.row["rig_id"] for scene in subject.scenes)}
    results = "".join(_results(scene, next(ids), features, characteristics, devices) for scene in subject.scenes)
    stats = statistics(subject, characteristics.measured, ids, FAMILY)
    runs = [scene.row["run_id"] for scene in subject.scenes]
    body = "".join(
        [
            _element("QPId", stable_uuid("document", subject.name, *runs)),
            f"<Version><TimeCreated>{_newest(subject)}</TimeCreated></Version>",
            "<Header><Application><Name>Flushline</Name></Application>",
            f"{_element('Description', subject.name)}</Header>",
            f'<StandardsDefinitions n="1"><Standard id="{_STANDARD}"><Organization><StandardsOrganizationEnum>ISO'
            "</StandardsOrganizationEnum></Organization><Designator>14253-1</Designator></Standard></StandardsDefinitions>",
            _UNITS,
            _devices(devices),
            _product(subject),
            features.definitions(),
            characteristics.definitions(),
            f'<Results><MeasurementResultsSet n="{len(subject.scenes)}">{results}</MeasurementResultsSet>',
            _component(subject),
            "</Results>",
            stats,
        ]
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<QIFDocument xmlns="{NAMESPACE}" versionQIF="3.0.0" '
        f'idMax="{next(ids)}">{body}</QIFDocument>\n'
    )


class _Features:
    """The features of a subject as points: definition, nominal, item and measurement of each."""

    def __init__(self, subject: Subject, ids: Iterator[int]) -> None:
        self.definition = next(ids)
        self._found = [
            (c.scene.scene_id, c.kind.name, c.feature, c)
            for _, group in groupby(subject.characteristics, key=lambda c: (c.scene.scene_id, *c.path[:2]))
            for c in [next(group)]
        ]
        self.ids = {found[:3]: (next(ids), next(ids), next(ids)) for found in self._found}

    def definitions(self) -> str:
        """The element Features."""
        if not self._found:
            return ""
        n = len(self._found)
        nominals, items = [], []
        for *key, c in self._found:
            nominal, item, _ = self.ids[(key[0], key[1], key[2])]
            x, y, z = _place(c)
            # Where there is no nominal place the measured one stands for it, as the attribute says.
            nominals.append(
                f'<PointFeatureNominal id="{nominal}">{_attributes(nominal_from="measured place")}'
                f"<FeatureDefinitionId>{self.definition}</FeatureDefinitionId>"
                f"<Location>{x:.5f} {y:.5f} {z:.5f}</Location></PointFeatureNominal>"
            )
            uuid = stable_uuid("feature", c.scene.row["panel"], c.scene.row["station"], *c.path[:2])
            items.append(
                f'<PointFeatureItem id="{item}"><FeatureNominalId>{nominal}</FeatureNominalId>'
                f"{_element('FeatureName', c.feature)}{_element('UUID', uuid)}{_MEASURED}</PointFeatureItem>"
            )
        return (
            f'<Features><FeatureDefinitions n="1"><PointFeatureDefinition id="{self.definition}"/></FeatureDefinitions>'
            f'<FeatureNominals n="{n}">{"".join(nominals)}</FeatureNominals>'
            f'<FeatureItems n="{n}">{"".join(items)}</FeatureItems></Features>'
        )

    def measurements(self, scene: ExportedScene) -> str:
        """The element MeasuredFeatures of a scene."""
        measured = []
        for *key, c in self._found:
            if c.scene is not scene:
                continue
            _, item, measurement = self.ids[(key[0], key[1], key[2])]
            x, y, z = _place(c)
            frame = "panel" if c.row["x_panel_mm"] is not None else "rig"
            said = _attributes(kind=c.kind.name, frame=frame, decision=c.row["decision"], reason=c.row["reason"])
            location = f"<Location>{x:.5f} {y:.5f} {z:.5f}</Location>" if _is_placed(c) else ""
            measured.append(
                f'<PointFeatureMeasurement id="{measurement}">{said}<FeatureItemId>{item}</FeatureItemId>'
                f"{location}</PointFeatureMeasurement>"
            )
        return f'<MeasuredFeatures n="{len(measured)}">{"".join(measured)}</MeasuredFeatures>' if measured else ""


class _Characteristics:
    """The characteristics of a subject: definitions shared by those of the same quantity and limit."""

    def __init__(self, found: Iterable[Characteristic], features: _Features, ids: Iterator[int]) -> None:
        self._found, self._features = list(found), features
        self._definition: dict[tuple[object, ...], int] = {}
        for c in self._found:
            if _asked(c) not in self._definition:
                self._definition[_asked(c)] = next(ids)
        self._ids = {c.number: (next(ids), next(ids)) for c in self._found}
        self.measured = {c.number: next(ids) for c in self._found}

    def definitions(self) -> str:
        """The element Characteristics."""
        if not self._found:
            return ""
        asked = {_asked(c): c for c in self._found}
        definitions = [_definition(c, self._definition[key]) for key, c in asked.items()]
        nominals, items = [], []
        for c in self._found:
            nominal, item = self._ids[c.number]
            family, feature = FAMILY[c.quantity.unit], self._feature(c)
            nominals.append(
                f'<{family}CharacteristicNominal id="{nominal}"><CharacteristicDefinitionId>'
                f"{self._definition[_asked(c)]}</CharacteristicDefinitionId>{_one('FeatureNominalIds', feature[0])}"
                f"</{family}CharacteristicNominal>"
            )
            items.append(
                f'<{family}CharacteristicItem id="{item}">{_element("Name", f"{c.feature} {c.quantity.name}")}'
                f"<CharacteristicDesignator><Designator>{c.number}</Designator>{_element('UUID', c.uuid)}"
                f"</CharacteristicDesignator>{_one('FeatureItemIds', feature[1])}"
                f"<CharacteristicNominalId>{nominal}</CharacteristicNominalId></{family}CharacteristicItem>"
            )
        parts = (("Definitions", definitions), ("Nominals", nominals), ("Items", items))
        lists = "".join(f'<Characteristic{n} n="{len(p)}">{"".join(p)}</Characteristic{n}>' for n, p in parts)
        return f"<Characteristics><FormalStandardId>{_STANDARD}</FormalStandardId>{lists}</Characteristics>"

    def measurements(self, scene: ExportedScene, device: int) -> str:
        """The element MeasuredCharacteristics of a scene."""
        measured = []
        for c in self._found:
            if c.scene is not scene:
                continue
            family = FAMILY[c.quantity.unit]
            # QIF's combined uncertainty is a standard one.
            sigma = "" if c.u95 is None else f' combinedUncertainty="{c.u95 / COVERAGE_95:.7f}"'
            value = "" if c.value is None else f"<Value{sigma}>{c.value:.5f}</Value>"
            said = _attributes(decision=c.decision, u95=None if c.u95 is None else f"{c.u95:.5f}")
            measured.append(
                f'<{family}CharacteristicMeasurement id="{self.measured[c.number]}">{said}<Status>'
                f"<CharacteristicStatusEnum>{STATUS[c.decision]}</CharacteristicStatusEnum></Status>"
                f"<CharacteristicItemId>{self._ids[c.number][1]}</CharacteristicItemId>"
                f"{_one('FeatureMeasurementIds', self._feature(c)[2])}{_one('MeasurementDeviceIds', device)}"
                f"{value}</{family}CharacteristicMeasurement>"
            )
        if not measured:
            return ""
        return (
            f'<MeasuredCharacteristics><CharacteristicMeasurements n="{len(measured)}">{"".join(measured)}'
            "</CharacteristicMeasurements></MeasuredCharacteristics>"
        )

    def _feature(self, c: Characteristic) -> tuple[int, int, int]:
        return self._features.ids[(c.scene.scene_id, c.kind.name, c.feature)]


def _definition(c: Characteristic, id_: int) -> str:
    family, tolerance = FAMILY[c.quantity.unit], "<NonTolerance>MEASURED</NonTolerance>"
    if c.limit:
        bounds = (("MaxValue", c.limit.upper), ("MinValue", c.limit.lower))
        inner = "".join(f"<{name}>{bound:.6f}</{name}>" for name, bound in bounds if bound is not None)
        tolerance = f"<Tolerance>{inner}<DefinedAsLimit>true</DefinedAsLimit></Tolerance>"
    source = _attributes(source=c.limit.source, revision=c.limit.revision) if c.limit else ""
    return (
        f'<{family}CharacteristicDefinition id="{id_}">{source}{_element("Name", c.quantity.title)}{tolerance}'
        f"{_element('WhatToMeasure', c.quantity.title)}</{family}CharacteristicDefinition>"
    )


def _asked(c: Characteristic) -> tuple[object, ...]:
    """What characteristics that share a definition have in common."""
    return c.kind.name, c.quantity.name, c.limit


def _results(
    scene: ExportedScene, id_: int, features: _Features, characteristics: _Characteristics, devices: dict[str, int]
) -> str:
    row = scene.row
    decisions = [feature["decision"] for rows in scene.features.values() for feature in rows]
    status = {STATUS.get(decision, "NOT_ANALYZED") for decision in decisions} or {"NOT_ANALYZED"}
    worst = next(name for name in ("FAIL", "NOT_ANALYZED", "PASS") if name in status)
    operator = (
        f"<InspectionOperator>{_element('Name', row['operator'])}</InspectionOperator>" if row["operator"] else ""
    )
    said = _attributes(scene_id=scene.scene_id, station=row["station"], panel_spec=row["panel_spec"])
    return (
        f'<MeasurementResults id="{id_}">{said}<InspectionTraceability><InspectionStart>{utc_text(row["captured_at"])}'
        f"</InspectionStart>{operator}</InspectionTraceability>"
        f"{_element('ThisResultsInstanceQPId', stable_uuid('results', scene.scene_id, row['run_id']))}"
        f"{features.measurements(scene)}{characteristics.measurements(scene, devices[row['rig_id']])}"
        f"<InspectionStatus><InspectionStatusEnum>{INSPECTION[worst]}</InspectionStatusEnum></InspectionStatus>"
        f"{_one('ActualComponentIds', _COMPONENT)}</MeasurementResults>"
    )


def _devices(devices: dict[str, int]) -> str:
    inner = "".join(
        f'<MeasurementDevice id="{id_}">{_element("Name", rig)}</MeasurementDevice>' for rig, id_ in devices.items()
    )
    listed = f'<MeasurementDevices n="{len(devices)}">{inner}</MeasurementDevices>'
    return f"<MeasurementResources>{listed}</MeasurementResources>"


def _product(subject: Subject) -> str:
    return (
        f'<Product><PartSet n="1"><Part id="{_PART}" label={_attribute(subject.panel)}>'
        f"{_element('UUID', stable_uuid('panel', subject.panel))}{_element('ModelNumber', subject.panel)}"
        "</Part></PartSet></Product>"
    )


def _component(subject: Subject) -> str:
    decisions = {STATUS.get(row["decision"], "NOT_ANALYZED") for row in subject.features}
    status = INSPECTION["FAIL" if "FAIL" in decisions else "PASS" if decisions == {"PASS"} else "NOT_ANALYZED"]
    return (
        f'<ActualComponentSets n="1"><ActualComponentSet n="1"><ActualComponent id="{_COMPONENT}">'
        f"{_element('SerialNumber', subject.aircraft_serial)}<Status><InspectionStatusEnum>{status}"
        "</InspectionStatusEnum></Status></ActualComponent></ActualComponentSet></ActualComponentSets>"
    )


def _newest(subject: Subject) -> str:
    return utc_text(max(scene.row["captured_at"] for scene in subject.scenes).astimezone(UTC))


def _is_placed(c: Characteristic) -> bool:
    return c.row["x_panel_mm"] is not None or c.row["x_mm"] is not None


def _place(c: Characteristic) -> tuple[float, float, float]:
    """In the panel's frame where it is known, else in the rig's; the origin where it was not measured."""
    part = "_panel" if c.row["x_panel_mm"] is not None else ""
    x, y, z = (c.row[f"{axis}{part}_mm"] or 0.0 for axis in "xyz")
    return x, y, z


def _one(name: str, id_: int) -> str:
    return f'<{name} n="1"><Id>{id_}</Id></{name}>'


def _element(name: str, text: object) -> str:
    return f"<{name}>{escape(_NOT_XML.sub('�', str(text)))}</{name}>"


def _attribute(text: object) -> str:
    return quoteattr(_NOT_XML.sub("�", str(text)))


def _attributes(**given: object) -> str:
    """The element Attributes: what QIF has no place for, by name; "" where there is nothing."""
    parts = [
        f"<AttributeStr name={_attribute(n)} value={_attribute(v)}/>" for n, v in given.items() if v not in (None, "")
    ]
    return f'<Attributes n="{len(parts)}">{"".join(parts)}</Attributes>' if parts else ""
