"""Studies: whatever is killed, every case is done once, and the table is that of a study that nobody touched."""

import csv
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pyarrow.parquet
import pytest

from experiments.scenarios.stand import Stand
from experiments.studies.backends import LocalBackend, connect
from experiments.studies.case import Case, Row, Study
from experiments.studies.engine import carry_out, rows_of
from experiments.studies.index import read_study
from experiments.studies.results_file import columns, write_results
from experiments.studies.runs import run_case
from experiments.studies.store import RowStore, write_whole
from robots.errors import ConfigError

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "tests" / "data" / "study_driver.py"
PATIENCE = 120.0
"""How long a process may take for what needs a second [s]."""


def driver_module() -> ModuleType:
    spec = importlib.util.spec_from_file_location("study_driver", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def driver() -> ModuleType:
    return driver_module()


class Playground:
    """A folder, a log, and the driver as a process that can be killed."""

    def __init__(self, folder: Path) -> None:
        self.out, self.log = folder / "study", folder / "log"
        self.log.touch()

    def start(self, jobs: int = 2) -> subprocess.Popen[str]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, str(SCRIPT), str(self.out), str(self.log), str(jobs)]
        return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)

    def finish(self, jobs: int = 2) -> str:
        process = self.start(jobs)
        _, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors
        return errors

    def tell(self, what: str, content: str = "") -> None:
        Path(f"{self.log}.{what}").write_text(content)

    def lines(self, word: str) -> list[list[str]]:
        return [line.split() for line in self.log.read_text().splitlines() if line.startswith(word)]

    def wait_for_begin(self, x: int) -> int:
        """Number of the process that has begun with ``x``."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            for _, case, pid in self.lines("begin"):
                if case == str(x):
                    return int(pid)
            time.sleep(0.02)
        raise AssertionError(f"case {x} never began")

    def wait_until(self, done: int) -> None:
        """Until this number of rows is there."""
        deadline = time.monotonic() + PATIENCE
        while len(list((self.out / "rows").glob("x-*.json"))) < done:
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def assert_each_done_once(self) -> None:
        ended = sorted(int(line[1]) for line in self.lines("end"))
        assert ended == [0, 1, 2, 4, 5, 6, 7]

    def table(self) -> list[dict[str, Any]]:
        """Rows but for what a clock says."""
        rows = read_study(self.out).rows()
        return [{"key": r.key, "labels": r.labels, "metrics": r.metrics, "error": r.error} for r in rows]


@pytest.fixture
def ground(tmp_path: Path) -> Playground:
    return Playground(tmp_path)


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The table of a study that nobody interrupted."""
    ground = Playground(tmp_path_factory.mktemp("untouched"))
    ground.finish()
    ground.assert_each_done_once()
    return ground.table()


def test_every_case_has_its_row_and_a_failure_is_one(untouched: list[dict[str, Any]]) -> None:
    assert [row["labels"]["x"] for row in untouched] == list(range(8))
    for x, row in enumerate(untouched):
        if x == 3:
            assert row["metrics"] == {}
            assert row["error"] == "ValueError: three is not allowed"
        else:
            assert row["metrics"] == {"square": x**2, "third": x / 3, "table": {"inner": str(x)}}
            assert row["error"] is None


def test_a_killed_driver_goes_on_where_it_was(ground: Playground, untouched: list[dict[str, Any]]) -> None:
    ground.tell("hold", "5")
    process = ground.start()
    ground.wait_for_begin(5)
    ground.wait_until(4)
    process.kill()
    process.wait()
    # its workers live on: the one that holds case 5 finishes it, and nobody does it a second time
    ground.tell("go")
    ground.finish()
    ground.assert_each_done_once()
    assert ground.table() == untouched


def test_killed_with_all_its_workers_it_keeps_what_was_stored(
    ground: Playground, untouched: list[dict[str, Any]]
) -> None:
    ground.tell("hold", "5")
    process = ground.start()
    ground.wait_for_begin(5)
    ground.wait_until(4)
    process.kill()
    for pid in {int(line[2]) for line in ground.lines("begin")}:
        os.kill(pid, signal.SIGKILL)
    process.wait()
    stored = {row["labels"]["x"] for row in ground.table()}
    assert len(stored) >= 4
    assert 5 not in stored
    ground.tell("go")
    ground.finish()
    assert ground.table() == untouched
    begun = [int(line[1]) for line in ground.lines("begin")]
    assert all(begun.count(x) == 1 for x in stored)


def test_a_killed_worker_costs_no_case(ground: Playground, untouched: list[dict[str, Any]]) -> None:
    ground.tell("hold", "5")
    process = ground.start()
    worker = ground.wait_for_begin(5)
    # what the other worker has in hand would go with it: it is ended too
    ground.wait_until(7)
    os.kill(worker, signal.SIGKILL)
    ground.tell("go")
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    ground.assert_each_done_once()
    assert ground.table() == untouched


def test_a_case_that_takes_every_process_down_is_a_failure_row(ground: Playground) -> None:
    ground.tell("kill", "6")
    ground.finish()
    rows = {row["labels"]["x"]: row for row in ground.table()}
    assert "ended" in rows[6]["error"]
    assert [x for x, row in rows.items() if row["error"] is None] == [0, 1, 2, 4, 5, 7]


def test_a_case_that_takes_the_driver_down_is_a_failure_row_of_the_next_one(ground: Playground) -> None:
    ground.tell("kill", "6")
    process = ground.start(jobs=1)
    process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGKILL
    ground.finish(jobs=1)
    rows = {row["labels"]["x"]: row for row in ground.table()}
    assert "ended" in rows[6]["error"]
    assert [x for x, row in rows.items() if row["error"] is None] == [0, 1, 2, 4, 5, 7]


def test_the_same_of_a_case_that_is_evaluated_while_no_other_is(tmp_path: Path) -> None:
    program = (
        "import os, sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
        "from study_driver import Square\n"
        "from experiments.studies.case import Case, Study\n"
        "from experiments.studies.engine import carry_out\n"
        "if __name__ == '__main__':\n"
        "    cases = [Case(f'x-{x}', {'x': x}, Square(x, sys.argv[3]), alone=True) for x in (1, 2)]\n"
        "    carry_out(Study('times', cases), Path(sys.argv[2]))\n"
    )
    (tmp_path / "driver.py").write_text(program)
    (tmp_path / "log.kill").write_text("1")
    path = os.pathsep.join([str(ROOT), str(SCRIPT.parent)])
    command = [sys.executable, "driver.py", str(SCRIPT.parent), "out", str(tmp_path / "log")]
    environment = {**os.environ, "PYTHONPATH": path}

    def start() -> int:
        return subprocess.run(command, check=False, cwd=tmp_path, env=environment, timeout=PATIENCE).returncode

    codes = [start(), start()]
    assert codes == [-signal.SIGKILL, 0]
    errors = [row.error for row in read_study(tmp_path / "out").rows()]
    assert "ended" in str(errors[0])
    assert errors[1] is None


def test_interrupted_it_keeps_what_is_done(ground: Playground, untouched: list[dict[str, Any]]) -> None:
    ground.tell("hold", "7")
    process = ground.start()
    ground.wait_for_begin(7)
    ground.wait_until(7)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE)
    assert process.returncode != 0
    assert len(ground.table()) == 7
    ground.tell("go")
    ground.finish()
    ground.assert_each_done_once()
    assert ground.table() == untouched


def test_a_second_driver_of_the_same_folder_is_refused(ground: Playground, driver: ModuleType) -> None:
    ground.tell("hold", "0")
    process = ground.start()
    ground.wait_for_begin(0)
    with pytest.raises(ConfigError, match="no other process is filling"):
        carry_out(driver.study(str(ground.log)), ground.out, LocalBackend(1))
    ground.tell("go")
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    ground.assert_each_done_once()


def test_one_process_gives_the_same_table(
    ground: Playground, driver: ModuleType, untouched: list[dict[str, Any]]
) -> None:
    carry_out(driver.study(str(ground.log)), ground.out, LocalBackend(1))
    ground.assert_each_done_once()
    assert ground.table() == untouched


def test_a_dask_cluster_gives_the_same_table(ground: Playground, untouched: list[dict[str, Any]]) -> None:
    script = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1]); import study_driver;"
        "from distributed import LocalCluster\n"
        "from experiments.studies.backends import connect\n"
        "if __name__ == '__main__':\n"
        "    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:\n"
        "        backend = connect(cluster.scheduler_address)\n"
        "        study_driver.carry_out(study_driver.study(sys.argv[3]), Path(sys.argv[2]), backend)\n"
        "        backend.client.close()\n"
    )
    file = ground.log.with_name("on_dask.py")
    file.write_text(script)
    path = os.pathsep.join([str(ROOT), str(SCRIPT.parent)])
    command = [sys.executable, str(file), str(SCRIPT.parent), str(ground.out), str(ground.log)]
    done = subprocess.run(
        command, check=False, env={**os.environ, "PYTHONPATH": path}, timeout=PATIENCE, capture_output=True
    )
    assert done.returncode == 0, done.stderr.decode()
    ground.assert_each_done_once()
    assert {line[2] for line in ground.lines("end")} != {str(os.getpid())}
    assert ground.table() == untouched


def test_a_cluster_that_is_not_there_is_refused() -> None:
    with pytest.raises(ConfigError, match="cluster"):
        connect("tcp://127.0.0.1:1")


@dataclass(frozen=True)
class Counted:
    """Counts its calls in a file; fails until the file ``mended`` is there."""

    log: Path
    fails: bool = False

    def __call__(self, store: RowStore) -> dict[str, Any]:
        with self.log.open("a") as file:
            file.write("x")
        if self.fails and not (store.folder / "mended").exists():
            raise RuntimeError("not mended")
        return {"calls": len(self.log.read_text())}


def test_cases_with_the_same_key_are_evaluated_once_and_keep_their_labels(tmp_path: Path) -> None:
    task = Counted(tmp_path / "log")
    study = Study("twice", [Case("a", {"x": 1}, task), Case("a", {"x": 2}, task)])
    rows = carry_out(study, tmp_path / "out", LocalBackend(1))
    assert [dict(row.labels) for row in rows] == [{"x": 1}, {"x": 2}]
    assert [row.metrics["calls"] for row in rows] == [1, 1]


def test_failures_stay_until_they_are_to_be_tried_again(tmp_path: Path) -> None:
    out = tmp_path / "out"
    study = Study(
        "mending", [Case("a", {}, Counted(tmp_path / "a", fails=True)), Case("b", {}, Counted(tmp_path / "b"))]
    )
    assert [row.error for row in carry_out(study, out, LocalBackend(1))] == ["RuntimeError: not mended", None]
    (out / "mended").touch()
    assert carry_out(study, out, LocalBackend(1))[0].error == "RuntimeError: not mended"
    again = carry_out(study, out, LocalBackend(1), retry_failed=True)
    assert [row.error for row in again] == [None, None]
    assert [row.metrics["calls"] for row in again] == [2, 1]


def test_series_that_are_asked_for_later_are_made(tmp_path: Path) -> None:
    def start(series: bool, scenario: Stand) -> Row:
        case = run_case(scenario, {}, "runs/stand", series)
        return carry_out(Study("series", [case]), tmp_path, LocalBackend(1))[0]

    stand, file = Stand(duration=0.1), tmp_path / "runs" / "stand" / "series.npz"
    start(False, stand)
    assert not file.exists()
    start(True, stand)
    made = file.stat().st_mtime_ns
    assert start(True, stand).error is None
    assert file.stat().st_mtime_ns == made


def test_a_failed_case_is_not_evaluated_again_for_the_files_that_it_did_not_leave(tmp_path: Path) -> None:
    case = Case("a", {}, Counted(tmp_path / "log", fails=True), "runs/a", files=("series.npz",))
    for _ in range(2):
        assert carry_out(Study("fails", [case]), tmp_path / "out", LocalBackend(1))[0].error is not None
    assert (tmp_path / "log").read_text() == "x"


def test_the_folder_of_another_study_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    task, out = Counted(tmp_path / "log"), tmp_path / "out"
    first = Study("first", [Case("a", {}, task), Case("b", {}, task)], command="safewbc sweep stand")
    carry_out(first, out, LocalBackend(1))
    with pytest.raises(ConfigError, match=r"'first', 'safewbc sweep stand'"):
        carry_out(Study("second", [Case("c", {}, task)]), out, LocalBackend(1), retry_failed=True)
    assert [row.key for row in read_study(out).rows()] == ["a", "b"]
    # one that has cases in common goes on
    carry_out(Study("wider", [Case("b", {}, task), Case("c", {}, task)]), out, LocalBackend(1))
    assert [row.key for row in read_study(out).rows()] == ["b", "c"]


def test_rows_of_other_versions_of_packages_are_kept_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study("old", [Case(key, {}, Counted(tmp_path / "log")) for key in ("a", "b")])
    carry_out(study, tmp_path / "out", LocalBackend(1))
    carry_out(study, tmp_path / "out", LocalBackend(1))
    assert "versions" not in capsys.readouterr().err
    path = tmp_path / "out" / "rows" / "a.json"
    row = json.loads(path.read_text())
    path.write_text(json.dumps(row | {"versions": row["versions"] | {"python": "2.7"}}))
    carry_out(study, tmp_path / "out", LocalBackend(1))
    (told,) = [line for line in capsys.readouterr().err.splitlines() if "versions" in line]
    assert told.endswith(f"kept: 1; python 2.7 (now {sys.version.split()[0]})")


KEYS = """
import sys
from pathlib import Path
from robots import loader
from experiments.scenarios.stand import Stand
from experiments.studies.runs import run_key

if len(sys.argv) > 1:
    loader.resources.files = lambda package: Path(sys.argv[1])
print(run_key(Stand()), run_key(Stand(robot="tocabi")))
"""


def test_the_key_of_a_run_stands_for_the_description_that_comes_with_the_project_too(tmp_path: Path) -> None:
    def keys(*arguments: str) -> list[str]:
        command = [sys.executable, "-c", KEYS, *arguments]
        return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()

    shutil.copytree(ROOT / "robots" / "data", tmp_path / "data")
    assert keys(str(tmp_path)) == keys()
    file = tmp_path / "data" / "g1.toml"
    text = file.read_text(encoding="utf-8")
    file.write_text(re.sub(r"(?m)^kp = .*$", "kp = 123.0", text, count=1), encoding="utf-8")
    before, after = keys(), keys(str(tmp_path))
    assert before[0] != after[0]
    assert before[1] == after[1]


@dataclass(frozen=True)
class Sum:
    """The sum of two further cases."""

    parts: tuple[Case, Case]

    def __call__(self, store: RowStore) -> dict[str, Any]:
        return {"sum": sum(store.obtain(case).metrics["calls"] for case in self.parts)}


def test_a_case_may_be_made_of_cases_which_are_kept_too(tmp_path: Path) -> None:
    parts = (Case("a", {}, Counted(tmp_path / "a")), Case("b", {}, Counted(tmp_path / "b")))
    study = Study("sum", [Case("sum", {}, Sum(parts)), *parts])
    rows = carry_out(study, tmp_path / "out", LocalBackend(1))
    assert rows[0].metrics == {"sum": 2}
    assert [row.metrics["calls"] for row in rows[1:]] == [1, 1]


def test_rows_come_as_soon_as_they_are_there(tmp_path: Path) -> None:
    log = tmp_path / "log"
    study = Study("slow", [Case(f"c{i}", {}, Counted(log)) for i in range(3)])
    rows: Iterator[Row] = rows_of(study, tmp_path / "out", LocalBackend(1))
    assert next(rows).metrics == {"calls": 1}
    assert log.read_text() == "x"
    assert [row.metrics["calls"] for row in rows] == [2, 3]


def test_what_json_does_not_take_is_a_failure(tmp_path: Path) -> None:
    study = Study("odd", [Case("odd", {}, Odd())])
    row = carry_out(study, tmp_path, LocalBackend(1))[0]
    assert row.error is not None
    assert row.error.startswith("TypeError")


@dataclass(frozen=True)
class Odd:
    """Returns what JSON does not take."""

    def __call__(self, store: RowStore) -> dict[str, Any]:
        return {"odd": object()}


@pytest.mark.parametrize("key", ["", "../up", "a/b", ".hidden", "x" * 201])
def test_a_key_is_a_file_name(key: str) -> None:
    with pytest.raises(ConfigError, match="key of a case"):
        Case(key, {}, Odd())


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_whole(path, "old")
    # what a killed process left beside does not matter
    (tmp_path / ".file.tmp").write_text("half of the n")
    write_whole(path, "new")
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    with pytest.raises(ConfigError, match="can be written"):
        write_whole(tmp_path / "no" / "folder", "x")


ROWS = [
    Row(
        "a",
        {"filter": "cbf", "epsilon": None, "n": 1},
        {"h": 0.1 + 0.2, "fell": False, "list": [1, 2]},
        folder="runs/a",
    ),
    Row(
        "b",
        {"filter": "issf", "epsilon": 2.5, "n": 2},
        {"h": 1, "fell": True, "sub": {"x": "y"}},
        None,
        1.5,
        {"p": "1"},
    ),
    Row("c", {"filter": "issf", "epsilon": 5.0, "n": 3}, {}, "ValueError: no"),
]


def test_columns_are_parameters_then_metrics_then_what_is_known_of_the_row() -> None:
    table = columns(ROWS)
    assert list(table) == [
        *("filter", "epsilon", "n", "h", "fell", "list", "sub.x"),
        *("key", "error", "seconds", "folder", "versions.p"),
    ]
    assert table["h"] == [0.1 + 0.2, 1.0, None]
    assert table["fell"] == [False, True, None]
    assert table["list"] == ["[1, 2]", None, None]
    assert table["error"] == [None, None, "ValueError: no"]


def test_csv_gives_every_digit_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.studies.results_file.find_spec", lambda name: None)
    with write_results(ROWS, tmp_path).open(newline="") as file:
        read = list(csv.DictReader(file))
    assert [float(row["h"]) for row in read[:2]] == [0.1 + 0.2, 1.0]
    assert [row["epsilon"] for row in read] == ["", "2.5", "5.0"]
    assert [row["error"] for row in read] == ["", "", "ValueError: no"]


def test_parquet_gives_everything_back(tmp_path: Path) -> None:
    assert pyarrow.parquet.read_table(write_results(ROWS, tmp_path)).to_pydict() == columns(ROWS)


def test_the_study_on_the_page_does_what_the_page_says(capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)[-1]
    exec(compile(code, "docs/studies.md", "exec"), {})
    assert capsys.readouterr().out.splitlines()[-1] == "[0, 1, 8] False"


def test_a_folder_tells_of_its_study(tmp_path: Path) -> None:
    study = Study("title", [Case("a", {"x": 1.5}, Counted(tmp_path / "log"), "runs/a")], command="safewbc sweep")
    carry_out(study, tmp_path / "out", LocalBackend(1))
    found = read_study(tmp_path / "out")
    assert (found.title, found.command) == ("title", "safewbc sweep")
    assert [(r.key, r.labels, r.folder) for r in found.rows()] == [("a", {"x": 1.5}, "runs/a")]
    stored = json.loads((tmp_path / "out" / "rows" / "a.json").read_text())
    assert stored["versions"]["python"] == sys.version.split()[0]
