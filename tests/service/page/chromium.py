"""Headless Chromium that looks at the page: what tests ask of it, in their own words."""

from __future__ import annotations

import base64
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.common.exceptions import StaleElementReferenceException, TimeoutException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.expected_conditions import staleness_of
from selenium.webdriver.support.ui import WebDriverWait

from wrenchbook.service.client import Client

WAIT_S = 120  # a limit for hung pages: the longest that pages wait for is one small solve, seconds
OPTIONS = (
    "--headless=new",
    "--no-sandbox",  # CI runs as root
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    # Drawings in space without a graphics card.
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # Debian's default is to paint everything by the graphics card, which is the processor here.
    "--disable-gpu-rasterization",
    "--disable-gpu-compositing",
)


def programs() -> tuple[str, str]:
    """Return Chromium and its driver; without them tests are skipped, and fail in CI."""
    browser, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if browser is None or driver is None:
        reported = "needs the Debian packages chromium and chromium-driver"
        pytest.fail(reported) if os.environ.get("CI") == "true" else pytest.skip(reported)
    return browser, driver


class Browser:
    """One window, at one server at a time."""

    def __init__(self, downloads: Path) -> None:
        browser, driver = programs()
        options = webdriver.ChromeOptions()
        options.binary_location = browser
        for option in OPTIONS:
            options.add_argument(option)
        options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(driver))
        self.driver.set_script_timeout(WAIT_S)
        self.server, self.downloads = "", downloads
        self.resize(1280, 900)

    def close(self) -> None:
        self.driver.quit()

    def resize(self, width: int, height: int) -> None:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)

    def colours(self, scheme: str) -> None:
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})

    def begin(self, client: Client) -> None:
        """Turn to a server as a new visitor does, with its key where it asks for one."""
        self.server = client.url
        self.visit("page/icon.svg")  # a file that all may have
        self.run("sessionStorage.clear(); localStorage.clear()")
        self.run("localStorage.setItem('wrenchbook-tour', 'yes')")  # whoever is new sees a tour
        if key := getattr(client, "_key", None):
            self.run("sessionStorage.setItem('wrenchbook-key', arguments[0])", key)
        self.mistakes()

    def visit(self, address: str) -> None:
        """Open an address of the server anew, however the last page was left."""
        self.driver.get("about:blank")
        self.driver.get(f"{self.server}/{address}")

    def go(self, address: str) -> None:
        """Go to an address of the page that is open, and wait until its view is there.

        The browser has no event for the address that is open already: it may be drawn by then.
        """
        self.run(
            "document.querySelector('main').replaceChildren();"
            "if (location.hash === arguments[0]) dispatchEvent(new HashChangeEvent('hashchange'));"
            "else location.hash = arguments[0]",
            address,
        )
        self.one("main h1")

    def run(self, script: str, *arguments: object) -> Any:
        return self.driver.execute_script(script, *arguments)

    def until(self, condition: Any, why: str = "") -> Any:
        """Return what a condition gives once it gives something."""

        def holds(_: object) -> Any:
            try:
                return condition()
            except StaleElementReferenceException:
                return None  # drawn anew between two looks

        try:
            return WebDriverWait(self.driver, WAIT_S, poll_frequency=0.05).until(holds)
        except TimeoutException:
            seen = self.run("return document.body?.innerText")
            raise AssertionError(
                f"{why or condition} did not come; the page shows:\n{seen}"
            ) from None

    def all(self, css: str) -> list[WebElement]:
        return self.driver.find_elements(By.CSS_SELECTOR, css)

    def one(self, css: str) -> WebElement:
        """Return the first element that is seen, waiting for it."""
        return self.until(lambda: next((e for e in self.all(css) if e.is_displayed()), None), css)

    def named(self, css: str, text: str) -> WebElement:
        """Return the first seen element with a text in it, waiting for it."""
        return self.until(
            lambda: next((e for e in self.all(css) if e.is_displayed() and text in e.text), None),
            f"{css} with {text!r}",
        )

    def text(self, css: str, part: str = "") -> str:
        """Return the text of the first seen element with a part in it, waiting for it.

        An element that is drawn anew before its text is read is looked up again.
        """
        return self.until(lambda: [self.named(css, part).text], f"{css} with {part!r}")[0]

    def attribute(self, css: str, name: str, part: str = "") -> str | None:
        """Return an attribute of the first seen element with a part in its text, as `text`."""
        return self.until(
            lambda: [self.named(css, part).get_attribute(name)], f"{css} with {part!r}"
        )[0]

    def click(self, css: str, text: str = "") -> None:
        """Click the first seen element with a text in it; one drawn anew is looked up again."""

        def clicked() -> bool:
            self.named(css, text).click()
            return True

        self.until(clicked, f"a click on {css} with {text!r}")

    def type(self, css: str, text: str) -> None:
        """Replace the text of a field; a field that is drawn anew meanwhile is looked up again."""

        def typed() -> bool:
            place = self.one(css)
            place.clear()
            place.send_keys(text)
            return place.get_attribute("value") == text

        self.until(typed, f"{css} with the value {text!r}")

    def gone(self, element: WebElement) -> None:
        """Wait until an element has left the page."""
        self.until(lambda: staleness_of(element)(self.driver), "the page drawn anew")

    def press(self, *keys: str) -> None:
        webdriver.ActionChains(self.driver).send_keys(*keys).perform()

    def tab_to(self, css: str, most: int = 60) -> None:
        """Press Tab until the focus is on a certain element."""
        for _ in range(most):
            if self.run("return document.activeElement?.matches(arguments[0])", css):
                return
            self.press(Keys.TAB)
        raise AssertionError(f"{most} times Tab do not lead to {css}")

    def drop(self, css: str, name: str, text: str) -> None:
        """Drop a file on an element, as a hand would."""
        self.run(
            """const carried = new DataTransfer();
            carried.items.add(new File([arguments[1]], arguments[2]));
            const how = {bubbles: true, cancelable: true, dataTransfer: carried};
            arguments[0].dispatchEvent(new DragEvent("drop", how));""",
            self.one(css),
            text,
            name,
        )

    def drawn(self, css: str) -> None:
        """Wait until something is drawn in a place."""
        self.one(f"{css}[data-drawn]")

    def picture(self, css: str) -> bytes:
        """Return a place as it is seen, a PNG."""
        return base64.b64decode(self.one(css).screenshot_as_base64)

    def mistakes(self) -> list[str]:
        """Return what the console tells of since it was last asked, but for refused calls."""
        reported = [entry for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
        return [item["message"] for item in reported if item["source"] != "network"]

    def hosts(self) -> set[str]:
        """Return the hosts that the page has asked for anything."""
        script = (
            "return performance.getEntriesByType('resource').map((one) => new URL(one.name).host)"
        )
        return set(self.run(script))
