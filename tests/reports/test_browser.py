"""The report in a real browser, which can reach no host: it draws every figure, and nothing is amiss."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fmuid.apps.cli.options import DONE
from tests.support.browser import PATIENCE, chromium
from tests.support.coil_study import STUDY, coil_table, fmuid_

pytestmark = pytest.mark.browser


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    with chromium(tmp_path) as driver:
        yield driver


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    coil_table(folder / "first.csv", 0.0, seed=1)
    evil = "<img src=https://example.org/x onerror=document.title=1> $$x^2$$"
    text = STUDY.replace("min = 0.0", "min = 0.0, prior = { mean = 4.0, std = 0.2 }").replace(
        'outputs = ["i"]', f'outputs = ["i"]\nname = "{evil}"'
    )
    asked = '[uncertainty]\nprofile_likelihood = ["R"]\ncost_map = [["R", "L"]]\n'
    (folder / "study.toml").write_text(text.replace('"Coil"', f'"{evil}"') + asked)
    assert fmuid_("identify", folder / "study.toml") == DONE
    return folder / "results" / "report.html"


def opened(driver: Any, report: Path) -> None:
    """Open a report and wait until all of its figures are drawn."""
    from selenium.webdriver.support.ui import WebDriverWait

    driver.get(report.as_uri())
    drawn = "return document.documentElement.dataset.drawn === 'all'"
    WebDriverWait(driver, PATIENCE).until(lambda it: it.execute_script(drawn))


def requests(driver: Any, report: Path) -> set[str]:
    """Return what the page has asked for, itself included, but for what it carries in itself."""
    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    asked = [each["params"] for each in messages if each["method"] == "Network.requestWillBeSent"]
    urls = {each["request"]["url"] for each in asked if each["documentURL"] == report.as_uri()}
    return {url for url in urls if not url.startswith(("data:", "blob:"))}


def test_a_report_opens_with_every_host_refused(browser: Any, report: Path) -> None:
    opened(browser, report)
    figures = browser.execute_script("return document.querySelectorAll('.cell').length")
    drawn = "return [...document.querySelectorAll('.cell')].filter(e => e.clientHeight > 50).length"
    assert figures > 8
    assert browser.execute_script(drawn) == figures
    assert [entry for entry in browser.get_log("browser") if entry["level"] not in ("INFO", "DEBUG")] == []
    assert requests(browser, report) == {report.as_uri()}
    assert browser.title.startswith("<img")
    assert not browser.execute_script("return document.images.length")


@pytest.mark.parametrize("width", [360, 1920])
def test_a_report_is_as_wide_as_its_window_and_follows_its_colours(browser: Any, report: Path, width: int) -> None:
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    opened(browser, report)
    from selenium.webdriver.support.ui import WebDriverWait

    models = "Bokeh.documents.flatMap(each => [...each.all_models])"
    colors = f"return [...new Set({models}.map(each => each.axis_label_text_color).filter(color => color))]"
    assert browser.execute_script(colors) == ["#24292f"]
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
    WebDriverWait(browser, PATIENCE).until(lambda it: it.execute_script(colors) == ["#e6edf3"])
