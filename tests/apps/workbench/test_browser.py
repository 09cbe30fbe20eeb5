"""The workbench in a real browser, which reaches this machine alone: by hand, by keyboard, narrow and wide."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from tornado.netutil import bind_sockets

from fmuid.apps.workbench import Folder, Workbench
from fmuid.processes import AVAILABLE
from tests.support.begun_batch import batch
from tests.support.browser import PATIENCE, chromium
from tests.support.coil_study import STUDY
from tests.support.cut_wire import Wire
from tests.support.misbehaving import Mode, misbehaving_fmu
from tests.support.results import result
from tests.support.workbench import coil_study, described, running

pytestmark = pytest.mark.browser

MODEL = "Bokeh.documents[0].get_model_by_name"
DRAWN = "document.documentElement.dataset.drawn === 'all'"
# The element inside all shadows that a selector finds in the view of a widget.
FIND = """
function find(root, name, selector) {
  for (const element of root.querySelectorAll("*")) {
    if (!element.shadowRoot) continue;
    const found = find(element.shadowRoot, name, selector);
    if (found) return found;
  }
  return [...root.querySelectorAll(selector)].find((each) => !name || each.textContent.trim() === name);
}
return find(document, arguments[0], arguments[1]);
"""
CLICK = "find(document, arguments[0], arguments[1]).click()"  # there and then: Bokeh may draw it anew meanwhile
ACTIVE = "let e = document.activeElement; while (e.shadowRoot?.activeElement) e = e.shadowRoot.activeElement; return e;"
# What a curve shows at a moment, by the words under which its tip says it.
TOLD = """(word => {
  const tips = tool => Array.isArray(tool.tooltips) ? tool.tooltips : [];
  const told = [...Bokeh.documents[0].all_models].find(each => tips(each).some(([said]) => said === word));
  const [, column] = tips(told).find(([said]) => said === word)[1].match(/@(\\w+)/);
  return told.renderers[0].data_source.data[column];
})"""
SQUARES = f"{TOLD}('residual').reduce((s, r) => s + r * r, 0)"
FOREIGN = """
const [base, done] = arguments;
const said = [];
fetch(base + "/", { credentials: "include" }).then(() => said.push("read"), () => said.push("refused")).then(() => {
  const wire = new WebSocket(base.replace("http", "ws") + "/study/ws", ["bokeh", "token"]);
  wire.onopen = () => done([...said, "opened"]);
  wire.onerror = () => done([...said, "refused"]);
});
"""


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    with chromium(tmp_path) as driver:
        driver.set_script_timeout(PATIENCE)
        yield driver


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return coil_study(tmp_path / "work").parent


@pytest.fixture
def address(folder: Path) -> Iterator[str]:
    with running(Workbench(Folder(folder))) as bench:
        yield bench.address


def wait(driver: Any, script: str) -> None:
    from selenium.common.exceptions import TimeoutException
    from selenium.webdriver.support.ui import WebDriverWait

    try:
        WebDriverWait(driver, PATIENCE).until(lambda it: it.execute_script(f"return {script}"))
    except TimeoutException:
        shown = driver.execute_script("return document.body.innerText")
        raise AssertionError(f"{script}: {driver.current_url}\n{shown}\n{driver.get_log('browser')}") from None


def open_study(driver: Any, address: str, name: str = "study.toml") -> None:
    driver.get(address)
    driver.get(f"{address.split('?')[0]}study?file={name}")
    wait(driver, DRAWN)


def residual(driver: Any) -> float:
    found: float = driver.execute_script(f"return {SQUARES}")
    return found


def press(driver: Any, button: str) -> None:
    driver.execute_script(FIND.replace("return find(document, arguments[0], arguments[1])", CLICK), button, "button")


def quiet(driver: Any) -> bool:
    return [entry for entry in driver.get_log("browser") if entry["level"] not in ("INFO", "DEBUG")] == []


def test_pages_open_with_every_other_host_refused(browser: Any, address: str) -> None:
    base = address.split("/?")[0]
    open_study(browser, address)
    wait(browser, f"{MODEL}('scores').text.includes('fit of i')")
    assert quiet(browser)
    asked = browser.execute_script("return performance.getEntriesByType('resource').map(each => each.name)")
    assert asked
    assert all(each.startswith((base, "data:", base.replace("http", "ws"))) for each in asked)


def test_the_keyboard_alone_moves_holds_and_identifies(browser: Any, address: str, folder: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    open_study(browser, address)
    wait(browser, f"{MODEL}('scores').text.includes('fit of i')")
    before = residual(browser)
    keys = ActionChains(browser)
    seen = []
    for _ in range(40):
        keys.send_keys(Keys.TAB).perform()
        active = browser.execute_script(ACTIVE)
        kind = active.get_attribute("class") or ""
        seen.append(f"{active.tag_name} {kind} {active.text}")
        if "noUi-handle" in kind and residual(browser) == before:
            keys.send_keys(Keys.ARROW_LEFT * 5).perform()
            wait(browser, f"{SQUARES} !== {before!r}")
        if active.text == "Identify":
            keys.send_keys(Keys.ENTER).perform()
            break
    else:
        raise AssertionError(seen)
    wait(browser, f"{MODEL}('state').text.includes('Done')")
    assert (folder / "results/report.html").is_file()
    assert any("hold" in each for each in seen)
    assert quiet(browser)


def behind(bench: Workbench, wire: Wire | None = None) -> Wire:
    """Have a wire lead to a workbench, which listens elsewhere."""
    found = wire or Wire(bench._sockets[0].getsockname())
    bench._sockets.pop().close()
    bench._sockets = bind_sockets(0, "127.0.0.1")
    found.server = bench._sockets[0].getsockname()
    return found


def test_a_page_that_was_cut_off_goes_on_and_one_whose_workbench_ended_says_so(browser: Any, folder: Path) -> None:
    said = "return document.getElementById('lost').textContent"
    bench = Workbench(Folder(folder))
    wire = behind(bench)
    with running(bench):
        wire.mend()
        open_study(browser, bench.address)
        assert browser.execute_script(said) == ""
        browser.execute_script(f"{MODEL}('typed R').value = '9.5'; {MODEL}('hold L').active = true; window.old = true")
        wait(browser, f"{MODEL}('command').text.includes('parameters.L=')")
        wire.cut()
        wait(browser, "!document.getElementById('lost').hidden")
        assert "does not answer" in browser.execute_script(said)
        wire.mend()
        wait(browser, f"!window.old && {DRAWN}")
        assert browser.execute_script(f"return [{MODEL}('typed R').value, {MODEL}('hold L').active]") == ["9.5", True]
        press(browser, "Identify")
        wait(browser, f"{MODEL}('state').text.includes('Done')")
        assert (folder / "results/result.json").is_file()
        wire.cut()
    other = Workbench(Folder(folder))
    behind(other, wire)
    with running(other):
        wire.mend()
        wait(browser, "document.getElementById('lost').textContent.includes('restarted')")
    wire.cut()


LONG, STEP = 1_000_000, 1e-3


def test_a_million_samples_are_zoomed_to_single_ones(browser: Any, address: str, folder: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    rng = np.random.default_rng(5)
    voltage = np.repeat(rng.choice([-1.0, 1.0], LONG // 50), 50)
    R, L = 6.0, 0.05  # the starts: what the page simulates, exactly, for a held voltage
    decay = np.exp(-R / L * STEP)
    exact = lfilter([0.0, (1.0 - decay) / R], [1.0, -decay], voltage)
    times = STEP * np.arange(LONG)
    measured = exact + 0.01 * rng.standard_normal(LONG)
    pd.DataFrame({"time": times, "u": voltage, "i": measured}).to_parquet(folder / "long.parquet")
    (folder / "long.toml").write_text(STUDY.replace("first.csv", "long.parquet"))
    open_study(browser, address, "long.toml")
    wait(browser, f"{MODEL}('scores').text.includes('fit of i')")
    figure = browser.execute_script(FIND, "", ".bk-events")
    across = figure.size["width"]
    widths = [LONG * STEP]
    for _ in range(4):
        drag = ActionChains(browser, duration=20).move_to_element_with_offset(figure, -across // 20, 0)
        drag.click_and_hold().move_by_offset(across // 20, 10).move_by_offset(across // 20, 10).release().perform()
        wait(browser, f"(t => t[t.length - 1] - t[0] < {0.5 * widths[-1]!r})({TOLD}('time'))")
        drawn = browser.execute_script(f"return [[...{TOLD}('time')], [...{TOLD}('simulated')]]")
        widths.append(drawn[0][-1] - drawn[0][0])
        rows = np.searchsorted(times, np.array(drawn[0]) - STEP / 2)
        np.testing.assert_allclose(drawn[1], exact[rows], atol=1e-5)
    assert widths[-1] < 2.0
    assert len(rows) == rows[-1] - rows[0] + 1  # each sample
    assert quiet(browser)


# What the keyboard must come to on each page, by the names that are read out.
REACHED = {
    "": ["Simulate and identify", "Faults", "Create from an FMU and data files", "choose old", "Side by side"],
    "study?file=study.toml": ["R", "typed R", "hold R", "Initial guess", "method", "Identify", "Fit", "Result"],
    "results?file=old": ["data file", "or drop a file here", "Predict", "Write the report"],
    "faults?file=faults.toml": ["data to monitor", "follow", "Diagnose", "Monitor"],
    "batch?file=out": ["cases", "containing", "case number"],
    "new": ["FMU", "data files, one per experiment (Ctrl for several)", "time column", "detrend", "study file"],
}
SEEN = """
const style = getComputedStyle(arguments[0]);
return style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0 || style.boxShadow !== "none";
"""


def tabbed(driver: Any) -> Iterator[tuple[str, Any]]:
    """Yield what Tab comes to from the beginning of the page to its end, by name; each must be seen to have it."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    for _ in range(80):
        ActionChains(driver).send_keys(Keys.TAB).perform()
        active = driver.execute_script(ACTIVE)
        if active.tag_name == "body":
            return
        canvas = "bk-events" in (active.get_attribute("class") or "")
        scrolls = "scroll" in (active.get_attribute("class") or "")
        name = active.accessible_name
        assert name or canvas or scrolls, active.get_attribute("outerHTML")
        assert driver.execute_script(SEEN, active), name
        yield name, active
    raise AssertionError("Tab does not come to the end of the page")


def test_the_keyboard_reaches_all_of_each_page(browser: Any, address: str, folder: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    (folder / "faults.toml").write_text(STUDY + "[diagnosis]\n")
    (folder / "old").mkdir()
    described(result(folder / "old", {"R": (4.0, 0.1)}))
    batch(folder / "out", 3)
    browser.get(address)
    base = address.split("?")[0]
    for page, wanted in REACHED.items():
        browser.get(base + page)
        wait(browser, DRAWN if page else "document.readyState === 'complete'")
        names = []
        for name, element in tabbed(browser):
            names.append(name)
            if name == "case number":
                element.send_keys("1", Keys.ENTER)
            if name == "Result":
                element.send_keys(Keys.ENTER)
        assert set(wanted) <= set(names), (page, names)
        if page.startswith("batch"):
            wait(browser, f"{MODEL}('case').text.includes('hit &lt;b&gt;a wall')")
        if page.startswith("study"):
            wait(browser, f"{MODEL}('main').active === 2")
    assert quiet(browser)


@pytest.mark.skipif(not AVAILABLE, reason="FMUs are not run in processes of their own here")
def test_an_identification_inside_a_long_simulation_is_cancelled(browser: Any, address: str, folder: Path) -> None:
    fmu = misbehaving_fmu(folder.parent)
    text = (folder / "study.toml").read_text().split("[parameters]")[0]
    text = (
        text.split("fmu =")[0]
        + f'fmu = "{fmu.as_posix()}"\nfixed = {{ mode = {int(Mode.SLOW)}, amount = 20000 }}\n'
        + ('[[experiments]]\ndata = "first.csv"\ninputs = ["u"]\noutputs = { x = "i" }\n')
    )
    (folder / "slow.toml").write_text(text + "[parameters]\ngain = { start = 1.0 }\n[isolation]\ntime_limit = 600\n")
    open_study(browser, address, "slow.toml")
    press(browser, "Identify")
    wait(browser, f"{MODEL}('state').text.includes('starting')")
    wait(browser, f"!{MODEL}('cancel').disabled")
    press(browser, "Cancel")
    wait(browser, f"{MODEL}('state').text.match(/Cancelled|interrupted/)")
    assert quiet(browser)


def test_a_foreign_page_reaches_nothing(browser: Any, address: str, folder: Path) -> None:
    base = address.split("/?")[0]
    open_study(browser, address)
    (folder.parent / "foreign.html").write_text("<title>foreign</title>")
    browser.get((folder.parent / "foreign.html").as_uri())
    assert browser.execute_async_script(FOREIGN, base) == ["refused", "refused"]


@pytest.mark.parametrize("width", [360, 800, 1920])
def test_pages_are_as_wide_as_their_window(browser: Any, address: str, width: int) -> None:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
    browser.get(address)
    wait(browser, "document.documentElement.dataset.scheme === 'dark' && document.readyState === 'complete'")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    open_study(browser, address)
    assert browser.execute_script("return document.documentElement.dataset.scheme") == "dark"
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    of_labels = "[...Bokeh.documents[0].all_models].map(model => model.axis_label_text_color).filter(color => color)"
    assert browser.execute_script(f"return [...new Set({of_labels})]") == ["#e6edf3"]
    browser.get(f"{address.split('?')[0]}new")
    wait(browser, DRAWN)
    browser.execute_script(f"{MODEL}('chosen').value = ['first.csv']")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
