"""The report in a real browser: no network, no script errors, no sideways scrolling, every number as in the files."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from selenium.webdriver import Chrome, ChromeOptions, Keys
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

from forestgen.dataset.report.page import write_report
from support.data_sets import SPLITS, write_data_set

IMAGES = 40
HOSTILE = "<img src=x onerror=\"document.title='taken'\">'</script><script>document.title='taken'</script>{{ 7*7 }}"
SMALLEST_TEXT = """
const scale = (svg) => svg ? svg.getBoundingClientRect().width / svg.viewBox.baseVal.width : 1;
const texts = [...document.querySelectorAll("svg text, p, td, th, li, label")].filter((one) => one.textContent.trim());
return Math.min(...texts.map((one) => parseFloat(getComputedStyle(one).fontSize) * scale(one.ownerSVGElement)));
"""
SECTIONS = (
    *("gallery", "classes", "instances", "species", "depth", "sun", "weather", "cameras", "draws", "failures"),
    *("timings", "provenance"),
)


@pytest.fixture(scope="module")
def browser():
    """One headless Chromium for all tests."""
    programs = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if None in programs:
        reason = "needs the programs chromium and chromedriver"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    options = ChromeOptions()
    options.binary_location = str(programs[0])
    for argument in ("--headless=new", "--disable-dev-shm-usage", *(["--no-sandbox"] if os.geteuid() == 0 else [])):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = Chrome(options, Service(programs[1]))
    driver.set_page_load_timeout(60)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def data_set(tmp_path_factory):
    """Its folder, and the rows of its index."""
    folder = tmp_path_factory.mktemp("report") / "data"
    rows = write_data_set(folder, IMAGES)
    write_report(folder, folder / "report.html")
    return folder, rows


@pytest.fixture
def page(browser, data_set):
    """The browser on the data set's report."""
    return opened(browser, data_set[0] / "report.html")


def opened(browser, path: Path):
    browser.get_log("performance"), browser.get_log("browser")  # what went before
    width(browser, 1280)
    browser.get(path.as_uri())
    return browser


def width(browser, pixels: int) -> None:
    screen = {"width": pixels, "height": 800, "deviceScaleFactor": 1, "mobile": pixels < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)


def requests(browser) -> list[str]:
    """Addresses that were asked for since the page was opened, the page's own left out."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [one["params"]["request"]["url"] for one in events if one["method"] == "Network.requestWillBeSent"]
    return [url for url in asked if not url.startswith("data:") and url != browser.current_url]


def find(browser, selector: str):
    return browser.find_element(By.CSS_SELECTOR, selector)


def texts(browser, selector: str) -> list[str]:
    script = "return [...document.querySelectorAll(arguments[0])].map((one) => one.textContent.trim())"
    return browser.execute_script(script, selector)


def facts(browser, selector: str) -> dict[str, str]:
    return dict(zip(texts(browser, f"{selector} dt"), texts(browser, f"{selector} dd"), strict=True))


def test_the_page_stands_alone(page):
    assert requests(page) == []
    assert page.get_log("browser") == []
    assert page.execute_script("return [...document.querySelectorAll('main section')].map(s => s.id)") == list(SECTIONS)
    assert all(texts(page, f"#{name} h2") for name in SECTIONS)
    assert texts(page, ".absent") == []
    links = page.execute_script("return [...document.querySelectorAll('nav a')].map(a => a.getAttribute('href'))")
    assert links == [f"#{name}" for name in SECTIONS]


def test_every_picture_decodes_and_says_what_it_shows(page):
    script = "return [...document.querySelectorAll('main img')].map(i => [i.naturalWidth, i.alt, i.complete])"
    pictures = page.execute_script(script)
    assert len(pictures) == 3 * (IMAGES - 1)
    assert all(pixels == 48 and alt and complete for pixels, alt, complete in pictures)
    names = page.execute_script("return [...document.querySelectorAll('svg[role=img]')].map(s => s.ariaLabel)")
    assert len(names) > 15
    assert all(names)


@pytest.mark.parametrize("pixels", [360, 1280])
def test_nothing_is_wider_than_the_screen(page, pixels):
    width(page, pixels)
    page.execute_script("document.querySelectorAll('details').forEach(one => { one.open = true })")
    assert page.execute_script("return document.documentElement.scrollWidth") <= pixels
    smallest = page.execute_script(SMALLEST_TEXT)
    assert smallest >= 9.5  # pixels, of text


def test_headline_counts_what_the_masks_hold(page, data_set):
    folder, rows = data_set
    told = facts(page, "#headline")
    assert told["images"] == told["frames"] == str(IMAGES - 1) == str(len(rows))
    assert told["splits"] == "3"
    plants = sum(
        len(np.unique(np.asarray(Image.open(path))[..., 0])) - 1 for path in folder.glob("*/*/instance.png")
        if not path.parent.name.startswith(f"{IMAGES - 1:06d}")
    )  # fmt: skip
    assert told["plants labelled"] == f"{plants:,}"
    assert f"1 image is missing: {IMAGES - 1}." in texts(page, "header .notes p")


def test_class_table_counts_what_the_masks_hold(page, data_set):
    folder, rows = data_set
    names = json.loads((folder / "train" / "classes.json").read_text())["semantic"]
    rows_shown = page.execute_script(
        "return [...document.querySelectorAll('#classes table')[0].tBodies[0].rows]"
        ".map(r => [r.cells[0].textContent.trim(), ...[...r.querySelectorAll('td .soft')].map(c => c.textContent)])"
    )
    shown = {name.removesuffix(" (sky)"): counts for name, *counts in rows_shown}
    masks = {split: [] for split in SPLITS}
    for row in rows:
        masks[row["split"]].append(np.asarray(Image.open(folder / row["folder"] / "semantic.png")))
    for number, name in names.items():
        counted = [sum(int((mask == int(number)).sum()) for mask in masks[split]) for split in SPLITS]
        assert shown[name] == [f"{count:,}" for count in counted]


def test_switch_by_click_and_by_keyboard(page):
    frame = find(page, "figure.frame")
    assert visible_picture(page, 0) == "picture"
    frame.find_element(By.CSS_SELECTOR, "label.plants").click()
    assert visible_picture(page, 0) == "plants"
    assert visible_picture(page, 1) == "picture"
    page.execute_script("arguments[0].focus()", frame.find_element(By.CSS_SELECTOR, "input:checked"))
    page.switch_to.active_element.send_keys(Keys.ARROW_RIGHT)
    assert visible_picture(page, 0) == "classes"
    find(page, "[data-all=plants]").send_keys(Keys.ENTER)
    assert {visible_picture(page, number) for number in range(IMAGES - 1)} == {"plants"}
    assert find(page, "[data-all=plants]").get_attribute("aria-pressed") == "true"


def visible_picture(browser, number: int) -> str:
    """Which view of a frame is displayed."""
    script = (
        "return [...document.querySelectorAll('figure.frame')[arguments[0]].querySelectorAll('img')]"
        ".filter(i => getComputedStyle(i).display !== 'none').map(i => i.className)"
    )
    (view,) = browser.execute_script(script, number)
    return view


def test_switches_need_no_script(page):
    page.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        page.refresh()
        find(page, "figure.frame label.classes").click()
        assert find(page, "figure.frame img.classes").is_displayed()
        assert not find(page, "figure.frame img.picture").is_displayed()
        assert not find(page, ".all.script").is_displayed()
    finally:
        page.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


def test_a_picture_opens_large(page):
    find(page, "figure.frame button.views").send_keys(Keys.ENTER)
    dialog = find(page, "#large")
    assert dialog.is_displayed()
    first = find(page, "#large-title").text
    shown = find(page, "#large-picture").get_attribute("src")
    assert shown == find(page, "figure.frame img.picture").get_attribute("src")
    page.switch_to.active_element.send_keys("2")
    assert find(page, "#large-picture").get_attribute("src") == find(page, "figure.frame img.plants").get_attribute(
        "src"
    )
    page.switch_to.active_element.send_keys(Keys.ARROW_RIGHT)
    assert find(page, "#large-title").text != first
    find(page, "[data-step='-1']").click()
    assert find(page, "#large-title").text == first
    page.switch_to.active_element.send_keys(Keys.ESCAPE)
    assert not dialog.is_displayed()
    assert page.switch_to.active_element == find(page, "figure.frame button.views")
    assert page.get_log("browser") == []


def test_failures_and_times_are_those_of_the_log(page, data_set):
    events = []
    for line in (data_set[0] / "run" / "log.jsonl").read_text().splitlines():
        try:
            events.append(json.loads(line))
        except ValueError:
            continue
    failed = [one for one in events if one["event"] == "job_failed"]
    told = facts(page, "#failures .facts")
    assert told == {"failed attempts": str(len(failed)), "images given up": "1", "workers lost": "1"}
    cells = texts(page, "#failures tbody td")
    assert cells[:2] == [failed[0]["message"], str(len(failed))]
    assert f"{IMAGES - 1} (attempt 3, given up)" in cells[2]
    done = [one for one in events if one["event"] == "job_done"]
    spent = {stage: sum(one["timings_s"][stage] for one in done) for stage in done[0]["timings_s"]}
    stages = dict(zip(texts(page, "#timings .what"), texts(page, "#timings .much"), strict=True))
    assert list(stages) == sorted(spent, key=lambda stage: -spent[stage])
    assert stages == {stage: f"{share(spent, stage)} · {spent[stage]:,.0f}" for stage in stages}
    assert facts(page, "#timings .facts")["peak memory of a worker"] == (
        f"{max(one['peak_memory_bytes'] for one in done) / 2**20:,.0f} MiB"
    )


def share(spent: dict[str, float], stage: str) -> str:
    return f"{100 * spent[stage] / sum(spent.values()):.3g}%"


def test_strangers_texts_are_texts(browser, tmp_path):
    write_data_set(tmp_path / "data", 6, species=(HOSTILE, "oak"), description=HOSTILE, message=HOSTILE)
    write_report(tmp_path / "data", tmp_path / "report.html")
    page = opened(browser, tmp_path / "report.html")
    assert page.title == f"{HOSTILE}: data set report"
    assert texts(page, "h1") == [HOSTILE]
    assert HOSTILE in texts(page, "#classes tbody th")
    assert HOSTILE in texts(page, "#failures tbody td")
    assert HOSTILE in texts(page, ".legend li")
    assert page.execute_script("return document.querySelectorAll('img[src=x]').length") == 0
    assert len(page.find_elements(By.TAG_NAME, "script")) == 1
    assert requests(page) == []
    assert page.get_log("browser") == []
    width(page, 360)
    assert page.execute_script("return document.documentElement.scrollWidth") <= 360


def test_an_empty_data_set_still_makes_a_page(browser, tmp_path):
    write_data_set(tmp_path / "data", 0, run=False)
    write_report(tmp_path / "data", tmp_path / "report.html")
    page = opened(browser, tmp_path / "report.html")
    assert page.get_log("browser") == []
    assert facts(page, "#headline")["frames"] == "0"
    assert len(texts(page, ".absent")) >= len(SECTIONS) - 2
