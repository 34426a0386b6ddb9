"""A filter from outside on the command line, as docs/safety.md has it."""

import os
import re
import subprocess
import sys
from pathlib import Path

from experiments.recording.recording import load_recording

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
SOURCE = next(b for b in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL) if "class Approach" in b)


def test_the_command_line_runs_it_and_the_run_can_be_loaded(tmp_path: Path) -> None:
    (tmp_path / "my_filters.py").write_text(SOURCE, encoding="utf-8")
    out = tmp_path / "run"
    program = "import sys; from experiments.cli.main import main; sys.exit(main())"
    arguments = ["run", "hand-tracking", "--filter", "my_filters:slow", "--duration", "0.2", "--out", str(out)]
    run = subprocess.run(
        [sys.executable, "-c", program, *arguments, "--no-video", "--no-report"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    result = load_recording(out)
    assert result.summary["filter"] == "my_filters:slow"
    assert result.summary["qp_failures"] == 0
