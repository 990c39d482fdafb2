"""A program for tests: says who it is and whom it started, answers lines, and ends when it is asked to, or never."""

import json
import signal
import subprocess
import sys
import time

if __name__ == "__main__":
    if "deaf" in sys.argv:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    other = subprocess.Popen(
        ["sleep", "60"], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
    )
    sys.stdout.write(f"{other.pid}\n")
    sys.stdout.flush()
    if "deaf" in sys.argv or "idle" in sys.argv:
        time.sleep(60)
    for line in sys.stdin:
        sys.stdout.write(json.dumps(json.loads(line)) + "\n")
        sys.stdout.flush()
