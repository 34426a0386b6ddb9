"""A scenario run from a script, kept in a folder, and read back: what a run leaves, and how to judge it.

python examples/read_recording.py [folder]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import safewbc as sw
from experiments.metrics.catalogue import known_metrics
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import PlantOptions


def record(folder: Path, duration: float) -> None:
    """Leave a run in ``folder``, as ``safewbc run hand-tracking --mass-scale 1.2 --out folder`` does."""
    sw.save_recording(sw.run(HandTracking(duration=duration, plant=PlantOptions(mass_scale=1.2))), folder)


def show(folder: Path) -> float:
    """Print what the run in ``folder`` came to; returns the RMS error of the left hand [mm]."""
    result = sw.load_recording(folder)
    print(f"{result.robot.title}, {len(result.series['time'])} ticks, {len(result.series)} arrays")
    for metric, (value,) in known_metrics([result]):
        print(f"  {metric.words} ({metric.unit or '-'}): {metric.text(value)}")
    series = result.series
    error = np.linalg.norm(series["left_hand"] - series["left_hand_ref"], axis=1)
    rms = 1e3 * float(np.sqrt(np.mean(error**2)))
    print(
        f"left hand from its reference, RMS: {rms:.1f} mm, largest {1e3 * error.max():.1f} mm at "
        f"{series['time'][error.argmax()]:.2f} s"
    )
    return rms


def main(duration: float = 4.0) -> float:
    """Show the run in the folder that is given, else one of ``duration`` [s] made for this."""
    if __name__ == "__main__" and len(sys.argv) > 1:
        return show(Path(sys.argv[1]))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        record(folder, duration)
        return show(folder)


if __name__ == "__main__":
    main()
