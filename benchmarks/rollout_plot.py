"""The picture of `benchmarks.rollout`: speed at batch 2, and cost against the number of vertices."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def plot(rows: list[dict[str, object]], path: Path, machine: str) -> None:
    """Draw the rows of one run."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
    pair = [row for row in rows if row["batch"] == 2]
    names = [f"{row['backend']} {row['variant']}, {row['threads']} thr." for row in pair]
    for offset, key, label in ((-0.2, "forward", "forward"), (0.2, "total", "forward + gradient")):
        ratios = [row.get(f"{key}_ratio") or 0 for row in pair]
        bars = left.barh([place + offset for place in range(len(pair))], ratios, 0.38, label=label)
        left.bar_label(bars, [f"{ratio:.3g}×" if ratio else "" for ratio in ratios], padding=3, fontsize=8)
    left.set_yticks(range(len(pair)), names)
    left.invert_yaxis()
    left.set_xscale("log")
    left.set_xlim(0.5, 3 * max(row.get("total_ratio") or row["forward_ratio"] for row in pair))
    left.set_xlabel("times faster than torch's edge list on one thread")
    left.set_title("batch 2")
    left.legend(loc="lower right")
    singles = [row for row in rows if row["batch"] == 1]
    for name in dict.fromkeys((row["backend"], row["variant"], row["threads"]) for row in singles):
        if name[2] == 2:
            continue
        own = sorted(
            (row["vertices"], row.get("total_ms") or row["forward_ms"])
            for row in singles
            if (row["backend"], row["variant"], row["threads"]) == name
        )
        what = " (forward)" if name[1] == "field" else ""
        right.plot(*zip(*own, strict=True), "o-", label=f"{name[0]} {name[1]}{what}")
    right.set_xscale("log")
    right.set_yscale("log")
    right.set_xticks(sorted({row["vertices"] for row in singles}))
    right.xaxis.set_major_formatter("{x:,.0f}")
    right.minorticks_off()
    right.set_xlabel("vertices")
    right.set_ylabel("forward + gradient [ms]")
    right.set_title("batch 1, one thread")
    right.grid(alpha=0.3)
    right.legend(fontsize=8)
    figure.suptitle(f"200-step rollout; {machine}", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)
