"""Workers killed with -9 at every stage of their jobs: how many maps are published once, how many jobs are lost.

    python benchmarks/kill_workers.py [--jobs 50] [--json]

Real workers on a real queue; the pipeline is that of the tests, which makes tiny maps. Every job's worker is killed
once, the next job's one stage later, up to after publishing; two workers are kept alive.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "jobs"))
from fake_pipeline import KILL_POINTS
from job_site import Site

from rholoc.jobs import JobState


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=50)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        site, start_s = Site(Path(folder)), time.monotonic()
        try:
            jobs = site.survive_kills([[KILL_POINTS[n % len(KILL_POINTS)]] for n in range(arguments.jobs)])
            puts = [site.control.count(f"put {job.map_name}") for job in jobs]
        finally:
            site.close()
    published = [job.state is JobState.PUBLISHED for job in jobs]
    figures = {
        "jobs": len(jobs),
        "workers_killed": sum(job.attempts - 1 for job in jobs),
        "published_once": sum(done and put == 1 for done, put in zip(published, puts, strict=True)),
        "published_again": sum(put > 1 for put in puts),
        "lost": len(jobs) - sum(published),
        "longest_s": round(max((job.ended or 0.0) - job.created for job in jobs), 1),
        "seconds": round(time.monotonic() - start_s, 1),
    }
    print(json.dumps(figures) if arguments.json else "\n".join(f"{name:16} {value}" for name, value in figures.items()))


if __name__ == "__main__":
    main()
