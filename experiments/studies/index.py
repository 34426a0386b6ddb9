"""``study.json``: which cases a folder of rows belongs to, so that tables can be made from the folder alone."""

import dataclasses
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.metrics.metric import Metric
from experiments.recording.plain import plain
from experiments.recording.store import STUDY
from experiments.studies.case import Row, Study
from experiments.studies.store import RowStore, read_json, row_from, write_whole
from robots.errors import ConfigError

FILE = STUDY


@dataclass(frozen=True, slots=True)
class StudyFolder:
    """A study as its folder tells of it.

    Attributes:
        folder: of the study.
        title: of the study.
        command: that makes it.
        cases: key, labels and folder of each, in order.
        metrics: how to show those that the project does not declare.
    """

    folder: Path
    title: str
    command: str
    cases: tuple[Mapping[str, Any], ...]
    metrics: tuple[Metric, ...] = ()

    def rows(self) -> list[Row]:
        """The rows that are there, in the order of the cases."""
        return list(self._rows())

    def _rows(self) -> Iterator[Row]:
        store = RowStore(self.folder)
        for case in self.cases:
            if case["key"] in store:
                table = read_json(self.folder / "rows" / f"{case['key']}.json")
                yield row_from(table, case["key"], case["labels"], case["folder"])


def write_index(study: Study, folder: Path) -> None:
    """Write ``study.json``.

    Raises:
        ConfigError: the folder is that of a study that has no case in common with this one.
    """
    if (folder / FILE).exists():
        _refuse_another(study, read_study(folder))
    cases = [{"key": case.key, "labels": case.labels, "folder": case.folder} for case in study.cases]
    metrics = [dataclasses.asdict(metric) for metric in study.metrics]
    content = {"title": study.title, "command": study.command, "metrics": metrics, "cases": cases}
    write_whole(folder / FILE, json.dumps(plain(content), indent=1, allow_nan=False) + "\n")


def _refuse_another(study: Study, there: StudyFolder) -> None:
    known = {case["key"] for case in there.cases}
    store = RowStore(there.folder)
    if not any(case.key in known or case.key in store for case in study.cases):
        allowed = f"a new folder, or one of this study; that one is of another: {there.title!r}, {there.command!r}"
        raise ConfigError("out", str(there.folder), allowed)


def read_study(folder: Path) -> StudyFolder:
    """What a folder says of its study.

    Raises:
        ConfigError: it is no folder of a study.
    """
    table = read_json(folder / FILE)
    try:
        metrics = tuple(Metric(**entry) for entry in table["metrics"])
        return StudyFolder(folder, table["title"], table["command"], tuple(table["cases"]), metrics)
    except KeyError as missing:
        raise ConfigError("study", str(folder / FILE), f"an object with the entry {missing}") from missing
