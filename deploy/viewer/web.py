"""The dashboard's web page, served by a child process: rerun's own function listens on every interface."""

from __future__ import annotations

import subprocess
from pathlib import Path
from urllib.parse import quote

import rerun_cli

STOP_S = 2.0
# The page must not outlive this process, however that ends: `read` returns when the pipe breaks.
_UNTIL_PIPE_BREAKS = '"$@" & read -r _; kill $!; wait $!'


class WebPage:
    """Serves rerun's web viewer at `url`; the data come from the server at `grpc_port`."""

    def __init__(self, bind: str, web_port: int, grpc_port: int) -> None:
        data = f"rerun+http://{bind}:{grpc_port}/proxy"
        self.url = f"http://{bind}:{web_port}?url={quote(data, safe='')}"
        # The executable itself: its Python wrapper would leave it running when it is stopped.
        program = str(Path(rerun_cli.__file__).with_name("rerun"))
        arguments = ["--serve-web", "--bind", bind, "--web-viewer-port", str(web_port), data]
        self._process = subprocess.Popen(
            ["sh", "-c", _UNTIL_PIPE_BREAKS, "sh", program, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def close(self) -> None:
        """End the child."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
