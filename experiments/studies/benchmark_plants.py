"""What filters keep, on a robot that is moved by torques, of what they do on an integrator: a table and a plot."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.metrics.metric import Metric
from experiments.recording.store import add_file
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from experiments.studies.progress import study_console

Entries = Mapping[str, Any]

PLOT = "plants.png"
"""File of the plot beside the rows."""

FIGURES = (
    Metric("hit", "episodes that touch", "%", 1e2),
    Metric("least", "least h", "mm", 1e3),
    Metric("success", "success", "%", 1e2),
)
"""Shown for each plant."""

DRAWN = ("hit", "least")
"""Of them, drawn."""


def show_plants(rows: Sequence[Entries], folder: Path) -> None:
    """Print the table of all rows, and write the plot."""
    from experiments.reports.plots.plants import Bars, plants_plot

    lines = by_plant(rows)
    plants = list(dict.fromkeys(row["plant"] for row in rows))
    columns = [Metric("filter", "filter"), Metric("episodes", "episodes")]
    columns += [
        Metric(f"{f.key} {plant}", f"{f.words}, {plant}", f.unit, f.factor) for f in FIGURES for plant in plants
    ]
    note = (
        "Scenes whose obstacles do not move, and in which nothing is touched at the start. Success: all goals were "
        "reached at one time, and nothing was touched."
    )
    show(rows_table(lines, tuple(columns), "From the integrator to torques", note))
    drawn = [
        Bars(line["filter"], *({p: line[f"{key} {p}"] for p in plants if f"{key} {p}" in line} for key in DRAWN))
        for line in lines
    ]
    data = plants_plot(drawn, plants)
    add_file(folder, PLOT, lambda path: path.write_bytes(data))
    study_console().print(f"plot:    {folder / PLOT}")


def by_plant(rows: Sequence[Entries]) -> list[dict[str, Any]]:
    """A line for each filter: figures of every plant, over the scenes that a filter can keep free of contact.

    Those are scenes that stand still and touch nothing at the start, and were played on all plants. Where a simulation
    blew up, that counts as touching.
    """
    found = []
    plants = list(dict.fromkeys(row["plant"] for row in rows))
    for name in dict.fromkeys(row["filter"] for row in rows):
        line: dict[str, Any] = {"filter": name}
        members_of: dict[str, dict[Any, Entries]] = {plant: {} for plant in plants}
        for row in rows:
            if row["filter"] == name and row["still"] and row["free"]:
                members_of[row["plant"]][row["case"], row["seed"]] = row
        shared = [scene for scene in members_of[plants[0]] if all(scene in members_of[plant] for plant in plants)]
        for plant in plants if shared else ():
            members = [members_of[plant][scene] for scene in shared]
            line["episodes"] = len(members)
            hits = [row["steps_in_collision"] > 0.0 or row["unstable"] for row in members]
            line[f"hit {plant}"] = sum(hits) / len(members)
            heights = [h for row in members for h in (row["min_h_obstacle_m"], row["min_h_self_collision_m"])]
            line[f"least {plant}"] = min(h for h in heights if h is not None)
            line[f"success {plant}"] = sum(row["success"] for row in members) / len(members)
        if "episodes" in line:
            found.append(line)
    return found
