"""The page in a real browser: it draws, turns, switches, slides, tells a support's figures, and complains of nothing."""

import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import screenshots
from PIL import Image

import relax
from relax.design.masts import standing_masts
from relax.plots.page import draw_page

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if not CHROMIUM or not DRIVER:
    missing = " and ".join(name for name, path in (("chromium", CHROMIUM), ("chromedriver", DRIVER)) if not path)
    pytest.skip(
        f"{missing} not found, which the page is tested in: apt-get install chromium chromium-driver", allow_module_level=True
    )
webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install 'relax-tensile[test]'")
ActionChains, By, Keys = webdriver.ActionChains, webdriver.common.by.By, webdriver.Keys

DATA = Path(__file__).parent.parent / "data"
EVIL = "Pavilion </script><img src=x onerror=document.title='harmed'> & a wave"
PLACES = """
const area = document.getElementById("canvas").getBoundingClientRect();
return space.struts.named.map(({ support, head, end }) => {
    const [a, b] = [space.pixel(head), space.pixel(end)];
    return [support.vertex, ...[0, 1].map((i) => a[i] + 0.7 * (b[i] - a[i]) + [area.x, area.y][i])];
});
"""


@pytest.fixture(scope="module")
def browser():
    with screenshots.browser() as window:
        yield window


@pytest.fixture(scope="module")
def design():
    design = relax.solve(relax.Problem(relax.load_scene(DATA / "pavilion.toml")))
    scene = design.problem.scene
    return replace(design, problem=replace(design.problem, scene=replace(scene, settings={**scene.settings, "title": EVIL})))


@pytest.fixture(scope="module")
def address(design, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "view.html"
    draw_page(design, path)
    return path.as_uri()


@pytest.fixture
def page(browser, address):
    """The page as it opens, 1000 x 700 pixels, and no complaint of the browser afterwards."""
    show(browser, address)
    yield browser
    assert browser.get_log("browser") == []


def show(browser, address, width=1000, height=700):
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get("about:blank")
    browser.get(address)


def text(page, name):
    return page.find_element(By.ID, name).text


def picture(page):
    """The middle of the canvas as it is seen, (H, W, 3) from 0 to 255."""
    page.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
    with Image.open(io.BytesIO(page.find_element(By.ID, "space").screenshot_as_png)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    height, width = pixels.shape[:2]
    return pixels[height // 5 : -height // 4, width // 8 : -width // 8]


def changed(before, after):
    """Share of pixels that are another colour."""
    return (np.abs(before - after).max(axis=-1) > 12).mean()


def press(page, *keys):
    ActionChains(page).send_keys(*keys).perform()


def test_it_opens_without_a_word_from_the_browser_and_draws(page):
    pixels = picture(page)
    assert (np.abs(pixels - 255).max(axis=-1) > 30).mean() > 0.3
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 500
    blue = (pixels[..., 2] > 120) & (pixels[..., 0] < 60)  # the dark end of the colours of the error
    assert blue.mean() > 0.02
    assert page.execute_script("return performance.getEntriesByType('resource').length") == 0


def test_the_title_is_text_and_no_script_of_it_runs(page):
    assert page.find_element(By.TAG_NAME, "h1").text == EVIL == page.title
    assert not page.find_elements(By.TAG_NAME, "img")
    assert "6 masts, 6 tie-downs; rms distance 0.497 m" in page.find_element(By.TAG_NAME, "header").text


def test_the_modes_change_the_picture_by_click_and_by_key(page):
    error = picture(page)
    page.find_element(By.XPATH, "//span[text()='membrane']").click()
    membrane = picture(page)
    assert changed(error, membrane) > 0.1
    assert not page.find_element(By.ID, "legend").is_displayed()
    press(page, "1")
    target = picture(page)
    assert changed(target, membrane) > 0.1 and changed(target, error) > 0.1
    assert page.find_element(By.CSS_SELECTOR, "input[value=target]").is_selected()
    press(page, "3")
    assert changed(picture(page), error) == 0
    page.find_element(By.ID, "slices").click()
    assert changed(picture(page), error) > 0.005


def test_the_slider_goes_through_the_run_and_moves_the_picture(page, design):
    last = len(design.trace.notes) - 1
    assert text(page, "place") == f"step {last} of {last}, result" and text(page, "count") == "12 supports"
    result = picture(page)
    slider = page.find_element(By.ID, "step")
    slider.send_keys(Keys.HOME)
    assert text(page, "place") == f"step 0 of {last}"
    first = picture(page)
    assert changed(first, result) > 0.1
    standing = [int(forces.any(axis=1).sum()) for forces in design.trace.forces]
    assert text(page, "count") == f"{standing[0]} supports"
    for step in range(1, 5):
        slider.send_keys(Keys.ARROW_RIGHT)
        assert text(page, "count") == f"{standing[step]} supports"
        assert design.trace.notes[step] in text(page, "note")
    assert changed(picture(page), first) > 0.05
    assert "new" in text(page, "note") or "gone" in text(page, "note")
    slider.send_keys(Keys.END)
    assert changed(picture(page), result) == 0


def test_the_run_plays_and_stops(page):
    # inside the page, since a slow machine would see it steps later: the step after the click, and the one where it is stopped
    watch = """
    const [play, place, done] = [document.getElementById("play"), document.getElementById("place"), arguments[0]];
    play.click();
    const first = place.textContent;
    new MutationObserver((_, watch) => {
        watch.disconnect();
        play.click();
        done([first, place.textContent]);
    }).observe(place, { childList: true });
    """
    first, stopped = page.execute_async_script(watch)
    assert first.startswith("step 0 of ") and stopped.startswith("step 1 of ")
    assert page.find_element(By.ID, "play").get_attribute("aria-label") == "play the run"
    page.find_element(By.ID, "canvas").send_keys(Keys.ARROW_RIGHT)
    assert text(page, "place").startswith("step 2 of ")


def touch(page, kind, x, y):
    """A click or a tap at a place of the window."""
    device = webdriver.common.actions.pointer_input.PointerInput(kind, kind)
    chain = webdriver.common.actions.action_builder.ActionBuilder(page, mouse=device, duration=0)
    chain.pointer_action.move_to_location(round(x), round(y)).click()
    chain.perform()


@pytest.mark.parametrize("kind", ["mouse", "touch"])
def test_a_click_on_a_support_tells_its_figures_and_one_elsewhere_lets_go(page, design, kind):
    before = picture(page)
    vertex, x, y = max(page.execute_script(PLACES), key=lambda place: place[2])  # the nearest to the eye: nothing hides it
    touch(page, kind, x, y)
    mast = next(mast for mast in design.supports if mast.vertex == vertex)
    said = text(page, "chosen")
    assert f"{mast.kind} at vertex {vertex}" in said
    assert f"{float(f'{mast.magnitude:.4g}'):g} N" in said and f"{mast.lean:.1f}\u00b0" in said
    assert f"{float(f'{mast.length:.4g}'):g} m" in said
    assert changed(before, picture(page)) > 0.001
    touch(page, kind, 60, 250)
    assert not page.find_element(By.ID, "chosen").is_displayed()


def test_a_support_is_reached_by_the_keyboard_and_kept_over_the_steps(page, design):
    vertex = design.supports[3].vertex
    page.find_element(By.XPATH, f"//button[text()='{vertex}']").send_keys(Keys.ENTER)
    assert f"at vertex {vertex}" in text(page, "chosen")
    assert page.switch_to.active_element.text == str(vertex)
    page.find_element(By.ID, "step").send_keys(Keys.HOME, Keys.ARROW_RIGHT)
    assert text(page, "chosen").endswith("no support at this step.") or f"vertex {vertex}" in text(page, "chosen")
    press(page, Keys.ESCAPE)
    assert not page.find_element(By.ID, "chosen").is_displayed()


def test_the_membrane_turns_and_comes_back(page):
    before = picture(page)
    canvas = page.find_element(By.ID, "canvas")
    ActionChains(page).drag_and_drop_by_offset(canvas, 120, 40).perform()
    turned = picture(page)
    assert changed(before, turned) > 0.1
    assert not page.find_element(By.ID, "chosen").is_displayed()  # a drag is no click
    ActionChains(page).key_down(Keys.SHIFT).send_keys(Keys.ARROW_LEFT).key_up(Keys.SHIFT).perform()
    assert changed(turned, picture(page)) > 0.1
    page.find_element(By.ID, "plan").click()
    assert changed(turned, picture(page)) > 0.1
    press(page, "r")
    assert changed(before, picture(page)) == 0


def test_an_address_says_what_is_shown(browser, address):
    show(browser, f"{address}#mode=membrane&step=2&vertex=325")
    assert browser.find_element(By.CSS_SELECTOR, "input[value=membrane]").is_selected()
    assert text(browser, "place").startswith("step 2 of ") and "vertex 325" in text(browser, "chosen").lower()
    show(browser, f"{address}#mode=nothing&step=999&vertex=<b>")
    assert ", result" in text(browser, "place") and browser.get_log("browser") == []


def test_supports_of_every_step_are_those_of_python(page, design):
    ground, trace = design.problem.scene.ground, design.trace
    read = "return record.supports(arguments[0]).map((one) => ({ ...one, foot: one.foot?.map((x, i) => x + record.origin[i]) }))"
    for step in (0, 3, len(trace.notes) - 1):
        ours = page.execute_script(read, step)
        theirs = standing_masts(trace.positions[step], trace.forces[step], ground)
        assert [(one["vertex"], one["kind"]) for one in ours] == [(mast.vertex, mast.kind) for mast in theirs]
        for one, mast in zip(ours, theirs, strict=True):
            # heads are told to 1 / 65534 of the largest displacement, some metres
            assert one["magnitude"] == pytest.approx(mast.magnitude, rel=1e-6)
            assert one["lean"] == pytest.approx(mast.lean, abs=1e-3)
            assert one["length"] == pytest.approx(mast.length, rel=1e-3, abs=1e-3)
            np.testing.assert_allclose(one["foot"], mast.foot, atol=1e-3 * max(1.0, mast.length))
        rms = page.execute_script("return record.rms(record.shape(arguments[0]).distance)", step)
        free = ~design.problem.scene.fixed
        away = np.linalg.norm(trace.positions[step] - design.problem.scene.target, axis=1)[free]
        assert rms == pytest.approx(np.sqrt(np.mean(away**2)), rel=1e-4)


def test_stays_heads_below_ground_and_feet_far_away(page):
    ground = page.execute_script("return record.ground")
    support = "return record.support(7, arguments[0], arguments[1])"
    stay = page.execute_script(support, [0, 0, ground + 1], [3, 4, 0])
    assert (stay["kind"], stay["foot"], stay["length"], stay["magnitude"]) == ("stay", None, None, 5)
    arrow = page.execute_script("return record.arrow")
    np.testing.assert_allclose(np.subtract(stay["end"], stay["head"]), [0.6 * arrow, 0.8 * arrow, 0.0], atol=1e-12)
    assert page.execute_script(support, [0, 0, ground - 1], [0, 0, 2])["kind"] == "stay"
    down = page.execute_script(support, [0, 0, ground + 2], [0, 0, -2])
    assert (down["kind"], down["length"], down["lean"], down["whole"]) == ("tie-down", 2, 0, True)
    far = page.execute_script(support, [0, 0, ground + 1], [-1, 0, 1e-5])
    assert far["kind"] == "mast" and far["length"] == pytest.approx(1e5) and not far["whole"]
    assert far["end"][0] == pytest.approx(page.execute_script("return record.room[1][0]"))


def test_it_fits_a_telephone_and_follows_a_new_size(page, address):
    show(page, address, 390, 844)
    assert page.execute_script("return document.documentElement.scrollWidth") <= 390
    assert (np.abs(picture(page) - 255).max(axis=-1) > 30).mean() > 0.2
    size = {"width": 700, "height": 500, "deviceScaleFactor": 2, "mobile": False}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    picture(page)
    canvas = "const c = document.getElementById('canvas'); return [c.width, 2 * c.clientWidth, c.height, 2 * c.clientHeight]"
    width, expected_width, height, expected_height = page.execute_script(canvas)
    assert (width, height) == (expected_width, expected_height)


def test_dark_pages_are_dark(page, address):
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": "dark"}]})
    try:
        show(page, address)
        assert np.median(page.execute_script("return [...space.renderer.getClearColor(new THREE.Color()).toArray()]")) < 0.1
        assert np.median(picture(page)[:20]) < 60
    finally:
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_without_webgl_a_sentence_stands_for_the_picture(browser, address):
    code = "HTMLCanvasElement.prototype.getContext = () => null;"
    planted = browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": code})
    try:
        show(browser, address)
        assert "This browser draws no WebGL" in text(browser, "notice")
        browser.find_element(By.XPATH, "//button[text()='325']").click()
        assert "tie-down at vertex 325" in text(browser, "chosen")
        browser.find_element(By.ID, "step").send_keys(Keys.HOME)
        assert text(browser, "place").startswith("step 0 of ")
    finally:
        browser.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", planted)
        browser.get_log("browser")
