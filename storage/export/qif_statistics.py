"""QIF 3.0 Statistics: each quantity over all features of a subject."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from statistics import fmean, stdev

from storage.export.subject import Characteristic, Subject, stable_uuid


def statistics(subject: Subject, measured: Mapping[int, int], ids: Iterator[int], family: Mapping[str, str]) -> str:
    """The element Statistics; "" where nothing was measured.

    Parameters
    ----------
    measured : mapping of int to int
        Ids of the measurements, by the numbers of the characteristics.
    ids : iterator of int
        Of the document.
    family : mapping of str to str
        QIF's kind of characteristic, by the unit.
    """
    groups: dict[tuple[str, str], list[Characteristic]] = {}
    for c in subject.characteristics:
        if c.value is not None:
            groups.setdefault((c.kind.name, c.quantity.name), []).append(c)
    if not groups:
        return ""
    studies = "".join(_study(subject, group, measured, next(ids), family) for group in groups.values())
    return (
        f'<Statistics><StatisticalStudiesResults n="{len(groups)}">{studies}</StatisticalStudiesResults></Statistics>'
    )


def _study(
    subject: Subject, group: list[Characteristic], measured: Mapping[int, int], id_: int, family: Mapping[str, str]
) -> str:
    values = [c.value for c in group if c.value is not None]
    figures = [("Average", fmean(values)), ("Maximum", max(values)), ("Minimum", min(values))]
    if len(values) > 1:
        figures.append(("StandardDeviation", stdev(values)))
    stats = "".join(f"<{name}><Value>{value:.7f}</Value></{name}>" for name, value in figures)
    name = f"{family[group[0].quantity.unit]}CharacteristicStats"
    listed = "".join(f"<Id>{measured[c.number]}</Id>" for c in group)
    uuid = stable_uuid("statistics", *(scene.row["run_id"] for scene in subject.scenes), *group[0].path[::2])
    status = "<Status><StatsEvalStatusEnum>INFORMATIONAL</StatsEvalStatusEnum></Status>"
    return (
        f'<SimpleStudyResults id="{id_}"><ThisStatisticalStudyResultsInstanceQPId>{uuid}'
        f"</ThisStatisticalStudyResultsInstanceQPId>{status}<Name>{group[0].quantity.title}</Name>"
        f'<CharacteristicsStats n="1"><{name}><MeasuredIds><Ids n="{len(group)}">{listed}</Ids></MeasuredIds>{status}'
        f"<ValueStats>{stats}</ValueStats></{name}></CharacteristicsStats>"
        f"<NumberOfSamples>{len(values)}</NumberOfSamples></SimpleStudyResults>"
    )
