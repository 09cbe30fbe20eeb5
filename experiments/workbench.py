"""The workbench in a browser: how long a slider takes to new data and to a painted curve, and its pages as pictures.

    python -m experiments.workbench            # the figures
    python -m experiments.workbench FOLDER     # instead: pictures of all pages, into this folder

Needs Chromium with its driver, and `selenium`. What is measured is the study of the induction machine: 4500 samples,
two outputs.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import fmuid
from experiments.batches import campaign

HERE = Path(__file__).parent
FLAGS = (
    *("headless", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking"),
    *("disable-component-update", "disable-sync", "disable-dev-shm-usage"),
    "host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
)
PATIENCE = 120.0
MOVES = 100

# One move of a slider: when the curve's new data is there, and when all four figures have been painted, ms.
MOVE = """
const [place, done] = arguments;
const doc = Bokeh.documents[0], slider = doc.get_model_by_name("Rs"), source = doc.get_model_by_name("lines");
const views = [...Bokeh.index.roots ?? Object.values(Bokeh.index)].flatMap(function all(view) {
  return [view, ...[...(view.children?.() ?? [])].flatMap(all)];
}).filter((view) => ["Figure", "Plot"].includes(view.model.type) && view.is_displayed);
const left = new Set(views), begun = performance.now();
let data = NaN;
const changed = () => { data = performance.now(); };
source.properties.data.change.connect(changed);
const handlers = views.map((view) => {
  const painted = () => {
    if (Number.isNaN(data)) return;
    left.delete(view);
    if (left.size > 0) return;
    source.properties.data.change.disconnect(changed);
    for (const [other, handler] of handlers) other.repainted.disconnect(handler);
    done([data - begun, performance.now() - begun, views.length]);
  };
  view.repainted.connect(painted);
  return [view, painted];
});
slider.value = place;
"""


@contextmanager
def opened(target: Path) -> Iterator[tuple[str, float]]:
    """Run the workbench, and give the address of its first page and how long it took to print it, s."""
    command = [sys.executable, "-m", "fmuid", "workbench", str(target), "--no-browser"]
    begun = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            address = next(line.strip() for line in process.stdout if line.startswith("http"))
            yield address, time.perf_counter() - begun
        finally:
            process.send_signal(signal.SIGINT)


@contextmanager
def browser() -> Iterator[Any]:
    """Give a browser that reaches this machine alone."""
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options: Any = Options()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome")
    for flag in FLAGS:
        options.add_argument(f"--{flag}")
    driver: Any = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        driver.set_script_timeout(PATIENCE)
        yield driver
    finally:
        driver.quit()


def wait(driver: Any, script: str) -> None:
    """Wait until a script returns true."""
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(driver, PATIENCE, 0.02).until(lambda it: it.execute_script(f"return {script}"))


DRAWN = "typeof Bokeh !== 'undefined' && Bokeh.documents.length > 0 && Bokeh.documents.every(d => d.is_idle)"


def measure(driver: Any, address: str) -> None:
    """Print how long pages and moves take."""
    begun = time.perf_counter()
    driver.get(address)
    print(f"first page, in the browser: {time.perf_counter() - begun:.2f} s")
    begun = time.perf_counter()
    driver.get(f"{address.split('?')[0]}study?file=study_prior.toml")
    wait(driver, DRAWN)
    print(f"page of the study, drawn: {time.perf_counter() - begun:.2f} s")
    time.sleep(2.0)
    rng = np.random.default_rng(1)
    found = np.array([driver.execute_async_script(MOVE, int(place)) for place in rng.integers(0, 1000, MOVES)])
    print(f"canvases {found[0, 2]:.0f}, moves {MOVES}")
    for name, times in (("slider to new data", found[:, 0]), ("slider to painted", found[:, 1])):
        print(f"{name}: median {np.median(times):.1f} ms, 95 % {np.quantile(times, 0.95):.1f} ms")


def pictures(driver: Any, address: str, folder: Path) -> None:
    """Take pictures of all pages."""
    base = address.split("?")[0]
    folder.mkdir(parents=True, exist_ok=True)
    driver.get(address)
    for name, (page, script) in PAGES.items():
        for kind, width, scheme in (("", 1300, "light"), ("-narrow", 360, "dark")):
            if kind and name not in NARROW:
                continue
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            wanted = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", wanted)
            driver.get(base)
            wait(driver, f"document.documentElement.dataset.scheme === '{scheme}'")
            driver.get(base + page)
            wait(driver, DRAWN if page else "document.readyState === 'complete'")
            if script:
                driver.execute_script(f"const model = (name) => Bokeh.documents[0].get_model_by_name(name); {script}")
            time.sleep(SETTLED)
            driver.save_screenshot(str(folder / f"{name}{kind}.png"))


SETTLED = 8.0
"""Seconds after which a page shows what it was asked for, also on a busy machine."""
# What stands in the pictures: the address of each page, and what is done there first.
PAGES = {
    "studies": ("", ""),
    "what-if": ("study?file=study_prior.toml", ""),
    "identified": ("study?file=study_prior.toml", "model('main').active = 2"),
    "results": ("results?file=results", ""),
    "side-by-side": ("results?file=results&file=free", ""),
    "faults": ("faults?file=coil/faults.toml", "model('records').value = 'coil/'"),
    "batch": ("batch?file=fleet/out", ""),
    "new": (
        "new",
        "model('fmu').value = 'coil/coil.fmu'; model('chosen').value = ['coil/bench.csv']; "
        "model('detrend').value = 'mean'",
    ),
}
NARROW = ("what-if",)
FAULTS = """\
title = "Coil on the bench"
[model]
fmu = "coil.fmu"
[[experiments]]
data = "faulty_coil.csv"
inputs = ["u"]
outputs = ["i"]
[diagnosis]
baseline = "healthy/result.json"
[diagnosis.faults.turns]
fmu = "turns.fmu"
parameters = { dR = { nominal = 1.0 } }
[monitoring]
false_alarm_rate = 0.01
"""


def coil(folder: Path) -> None:
    """Write a study of faults, and a table whose columns have other names than the model's."""
    healthy, faulty = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    folder.mkdir()
    for source, name in ((healthy.fmu, "coil.fmu"), (faulty.fmu, "turns.fmu"), (faulty.path, faulty.path.name)):
        shutil.copy(source, folder / name)
    fmuid.run(fmuid.Study.of(healthy.study, folder / "coil.toml"), folder / "healthy")
    (folder / "faults.toml").write_text(FAULTS)
    table = healthy.table.rename(columns={"u": "U_set (V)", "i": "I_meas (A)"})
    table.assign(time=1e3 * table["time"]).rename(columns={"time": "Time (ms)"}).to_csv(
        folder / "bench.csv", index=False, sep=";", decimal=","
    )


def results(folder: Path) -> None:
    """Run what the pictures show: an identification, the same from another start, faults, a batch."""
    (folder / "fleet").mkdir()
    fleet = campaign.write_study(folder / "fleet", 40)
    coil(folder / "coil")
    for words in (
        ("identify", "study_prior.toml", "--set", 'uncertainty.cost_map=[["Rs", "Lm"]]'),
        ("identify", "study_prior.toml", "--output", "free", "--set", "parameters.Rs.prior.std=1.0"),
        ("batch", str(fleet), "--output", "fleet/out"),
        ("diagnose", "coil/faults.toml"),
        ("monitor", "coil/faults.toml", "coil/faulty_coil.csv"),
    ):
        done = subprocess.run([sys.executable, "-m", "fmuid", *words], cwd=folder, capture_output=True, text=True)
        assert done.returncode < 2, done.stderr


def study(folder: Path) -> Path:
    """Copy the study of the induction machine into a folder."""
    source = HERE / "induction_machine"
    folder.mkdir()
    text = (source / "study_prior.toml").read_text().replace("../../fmus", (HERE.parent / "fmus").as_posix())
    (folder / "study_prior.toml").write_text(text)
    shutil.copy(source / "table.csv", folder)
    return folder


def main() -> None:
    """Measure, and take pictures where a folder is given for them."""
    with tempfile.TemporaryDirectory() as place:
        folder = study(Path(place) / "induction-machine")
        if sys.argv[1:]:
            results(folder)
        with opened(folder) as (address, seconds), browser() as driver:
            if sys.argv[1:]:
                pictures(driver, address, Path(sys.argv[1]))
            else:
                print(f"address printed after {seconds:.2f} s")
                measure(driver, address)


if __name__ == "__main__":
    main()
