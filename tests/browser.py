"""A headless Chromium, driven over its debugging pipe: no driver, no server, no network."""

import base64
import fcntl
import itertools
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
LEFT_OUT = "left out: the tests in a browser (no Chromium here: install Debian's chromium, or set CHROMIUM to its path)"
_OPTIONS = (
    "headless no-sandbox remote-debugging-pipe no-first-run disable-gpu hide-scrollbars disable-extensions "
    "disable-background-networking disable-component-update disable-sync disable-dev-shm-usage mute-audio"
)
_PATIENCE_S = 30.0


def find_browser() -> str | None:
    """The Chromium of this machine: $CHROMIUM, or one on the path."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One process of Chromium, with a page at a time.

    Chromium reads commands from descriptor 3 and answers on descriptor 4, each a JSON object that ends with a zero.
    """

    def __init__(self, executable: str, profile: Path) -> None:
        commands, self._commands = self._pipe()
        self._answers, answers = self._pipe()
        call = [executable, *(f"--{name}" for name in _OPTIONS.split()), "--host-resolver-rules=MAP * ~NOTFOUND"]
        call += [f"--user-data-dir={profile}", "about:blank"]
        shell = ["bash", "-c", f'exec "$@" 3<&{commands} 4>&{answers}', "bash", *call]
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(shell, pass_fds=(commands, answers), **quiet)  # type: ignore[call-overload]
        os.close(commands)
        os.close(answers)
        self._numbers = itertools.count(1)
        self._rest = b""
        self._session: str | None = None
        self.errors: list[str] = []  # of the present page's scripts, and what it asked the network for

    @staticmethod
    def _pipe() -> tuple[int, int]:
        """A pipe whose ends the shell can move to 3 and 4."""
        ends = os.pipe()
        high = fcntl.fcntl(ends[0], fcntl.F_DUPFD_CLOEXEC, 10), fcntl.fcntl(ends[1], fcntl.F_DUPFD_CLOEXEC, 10)
        for end in ends:
            os.close(end)
        return high

    def close(self) -> None:
        """End the process."""
        os.close(self._commands)
        os.close(self._answers)
        self._process.terminate()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def command(self, method: str, **parameters: Any) -> Any:
        """Send a command of Chromium's protocol and return its result."""
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while (answer := self._read()).get("id") != number:
            self._note(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def _read(self) -> dict[str, Any]:
        until = time.monotonic() + _PATIENCE_S
        while b"\0" not in self._rest:
            if not select.select([self._answers], [], [], max(0.0, until - time.monotonic()))[0]:
                raise TimeoutError("Chromium does not answer")
            part = os.read(self._answers, 1 << 20)
            if not part:
                raise RuntimeError("Chromium has ended")
            self._rest += part
        message, self._rest = self._rest.split(b"\0", 1)
        answer: dict[str, Any] = json.loads(message)
        return answer

    def _note(self, event: dict[str, Any]) -> None:
        """Keep what a page must not do."""
        method, found = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = found["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Log.entryAdded" and found["entry"]["level"] == "error":
            self.errors.append(found["entry"]["text"])
        elif method == "Runtime.consoleAPICalled" and found["type"] in ("error", "warning"):
            self.errors.append(str(found["args"]))
        elif method == "Network.requestWillBeSent" and not found["request"]["url"].startswith(("file:", "data:")):
            self.errors.append(f"asked for {found['request']['url']}")

    def open(
        self,
        page: Path,
        width: int = 1000,
        height: int = 760,
        *,
        dark: bool = False,
        still: bool,
        phone: bool = False,
        dense: int = 1,
    ) -> None:
        """Open a file and wait until its mission is shown."""
        if self._session is None:
            target = self.command("Target.createTarget", url="about:blank")["targetId"]
            self._session = self.command("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.command(f"{domain}.enable")
        self.command("Page.navigate", url="about:blank")
        self.errors = []
        self.command(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=dense, mobile=phone
        )
        features = {"prefers-color-scheme": "dark" if dark else "light"}
        features["prefers-reduced-motion"] = "reduce" if still else "no-preference"
        self.command("Emulation.setEmulatedMedia", features=[{"name": k, "value": v} for k, v in features.items()])
        self.command("Page.navigate", url=page.resolve().as_uri())
        self.wait("!!window.replay || document.querySelector('#problem')?.hidden === false")

    def value(self, script: str) -> Any:
        """What an expression of JavaScript gives in the page."""
        answer = self.command("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"].get("description", script))
        return answer["result"].get("value")

    def text(self, selector: str) -> str:
        """The text of the first element that the selector names."""
        return str(self.value(f"document.querySelector({json.dumps(selector)}).textContent"))

    def texts(self, selector: str) -> list[str]:
        """The texts of all elements that the selector names."""
        return list(self.value(f"[...document.querySelectorAll({json.dumps(selector)})].map((e) => e.textContent)"))

    def wait(self, script: str) -> None:
        """Wait until an expression holds."""
        until = time.monotonic() + _PATIENCE_S
        while not self.value(script):
            if time.monotonic() > until:
                raise TimeoutError(f"never came true: {script}; {self.errors}")
            time.sleep(0.02)

    def press(self, key: str, shift: bool = False) -> None:
        """Press a key."""
        code = {" ": ("Space", 32), "ArrowLeft": ("ArrowLeft", 37), "ArrowRight": ("ArrowRight", 39)}.get(key, (key, 0))
        pressed = {"key": key, "code": code[0], "windowsVirtualKeyCode": code[1], "modifiers": 8 * shift}
        text = {"text": key} if len(key) == 1 else {}
        self.command("Input.dispatchKeyEvent", type="keyDown", **pressed, **text)
        self.command("Input.dispatchKeyEvent", type="keyUp", **pressed)

    def click(self, selector: str, across: float = 0.5, down: float = 0.5) -> None:
        """Click into an element, at shares of its width and height."""
        named = json.dumps(selector)
        self.value(f"document.querySelector({named}).scrollIntoView({{block: 'center'}})")
        corners = f"document.querySelector({named}).getBoundingClientRect()"
        box = self.value(f"(({{x, y, width, height}}) => [x, y, width, height])({corners})")
        at = {"x": box[0] + across * box[2], "y": box[1] + down * box[3], "button": "left", "clickCount": 1}
        for kind in ("mousePressed", "mouseReleased"):
            self.command("Input.dispatchMouseEvent", type=kind, buttons=int(kind == "mousePressed"), **at)

    def screenshot(self, path: Path) -> None:
        """Write what the window shows as PNG."""
        path.write_bytes(base64.b64decode(self.command("Page.captureScreenshot", format="png")["data"]))


if __name__ == "__main__" and find_browser() is None:
    print(LEFT_OUT)
