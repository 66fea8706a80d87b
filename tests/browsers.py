# SPDX-License-Identifier: BSD-3-Clause
"""A real browser without a window, and what it asked for."""

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

# SwiftShader is WebGL without a graphics card. No name resolves: nothing is reached by accident
# but a server of a test on this machine.
FLAGS = (
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-default-apps",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "--window-size=1440,900",
)  # fmt: skip
LOCAL = ("file:", "blob:", "data:", "about:", "chrome:", "chrome-untrusted:", "devtools:")


def found(*names: str) -> str | None:
    return next((path for path in map(shutil.which, names) if path), None)


@contextmanager
def open_browser(profile: Path) -> Iterator[Any]:
    """Start Chromium with an empty profile; skip the test where there is none."""
    webdriver = pytest.importorskip("selenium.webdriver")
    browser = found("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    driver_path = found("chromedriver")
    if browser is None or driver_path is None:
        pytest.skip("no Chromium with its chromedriver on this machine")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(executable_path=driver_path)
    driver = webdriver.Chrome(options=options, service=service)
    try:
        yield driver
    finally:
        driver.quit()


def show(driver: Any, path: Path, *, width: int = 1440, dark: bool = False) -> None:
    """Open a file as a screen of this width would; what the browser asked before is forgotten."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
    driver.get_log("browser")
    driver.get(path.as_uri())


def requests_elsewhere(driver: Any, *, served_at: str | None = None) -> list[str]:
    """Addresses that the browser asked for outside the page's own file, or its own server."""
    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    sent = [m for m in messages if m["method"] == "Network.requestWillBeSent"]
    addresses = [message["params"]["request"]["url"] for message in sent]
    sockets = [m for m in messages if m["method"] == "Network.webSocketCreated"]
    addresses += [m["params"]["url"].replace("ws://", "http://") for m in sockets]
    local = LOCAL if served_at is None else (*LOCAL, served_at)
    return [address for address in addresses if not address.startswith(local)]


def errors(driver: Any) -> list[str]:
    """What the page's scripts complained about."""
    return [e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE"]


def wait_for(driver: Any, script: str, *arguments: Any, seconds: float = 10.0) -> Any:
    """Return what a script answers as soon as that is something."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        answer = driver.execute_script(script, *arguments)
        if answer:
            return answer
        time.sleep(0.05)
    pytest.fail(f"nothing came of {script}")
