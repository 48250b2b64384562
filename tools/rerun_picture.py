"""A picture of a file in Rerun's viewer: ``python tools/rerun_picture.py run.rrd OUT.png [--seconds 20]``.

Rerun's own window needs a screen and a graphics card. Its viewer for browsers is the same program, and a headless
Chromium draws it by software; nothing is asked from outside this machine.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import time
from pathlib import Path

from browser import open_browser


def main() -> None:
    """Serve the file, open it, wait and take the picture."""
    parser = argparse.ArgumentParser(prog="python tools/rerun_picture.py", description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0, help="until all of it is drawn")
    chosen = parser.parse_args()
    page, data = _free_port(), _free_port()
    command = [sys.executable, "-m", "rerun_cli", "--serve-web", "--web-viewer-port", str(page), "--port", str(data)]
    with subprocess.Popen([*command, str(chosen.file)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            _wait_for(page)
            with open_browser(webgl=True) as browser:
                browser.window(1400, 900, dark=True)
                browser.open(f"http://localhost:{page}/?url=rerun%2Bhttp://localhost:{data}/proxy&renderer=webgl")
                time.sleep(chosen.seconds)
                browser.screenshot(chosen.picture)
        finally:
            server.terminate()
    print(chosen.picture)


def _free_port() -> int:
    with socket.socket() as listening:
        listening.bind(("localhost", 0))
        return int(listening.getsockname()[1])


def _wait_for(port: int, patience_s: float = 30.0) -> None:
    end_s = time.monotonic() + patience_s
    while time.monotonic() < end_s:
        with socket.socket() as client:
            if client.connect_ex(("localhost", port)) == 0:
                return
        time.sleep(0.2)
    raise TimeoutError(f"Rerun did not serve within {patience_s:g} s")


if __name__ == "__main__":
    main()
