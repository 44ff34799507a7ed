"""The page of components with several interfaces, and with a temperature."""

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.timeout(240)]

VIEWS = ("overview", "query", "jobs", "table", "entry")


def drawn(browser):
    browser.drawn("#loads")


def test_loads_by_interface_are_asked_and_each_interface_has_its_displacement(browser):
    browser.visit("#/c/link/query")
    drawn(browser)
    for name in ("right.fx", "right.fy", "right.mx", "right.my", "right.mz"):
        browser.type(f"input[name='{name}']", "0")
    browser.type("input[name='right.fz']", "-150")
    browser.named("form button", "Ask").click()
    browser.until(lambda: browser.all("table.answer"))
    captions = [one.text for one in browser.all("table.answer caption")]
    assert captions == ["left", "right"]
    assert "uz −3.89 mm" in browser.all("table.answer")[1].text
    assert "No loads at left" in browser.one("main").text
    assert "covered" in browser.one("main").text


def test_a_temperature_is_asked_beside_the_wrench(browser):
    browser.visit("#/c/hot_bracket/query")
    drawn(browser)
    assert browser.one("input[name='temperature']").get_attribute("value") == "20"
    browser.type("input[name='temperature']", "80")
    browser.named("form button", "Ask").click()
    browser.until(lambda: browser.all("table.answer"))
    assert "temperature 80" in browser.one("main").text


def test_arrows_follow_the_loads_that_are_typed(browser):
    browser.visit("#/c/link/query")
    drawn(browser)
    before = browser.run("return document.querySelector('#loads').dataset.drawn")
    browser.type("input[name='right.fy']", "100")
    arrows = "return document.querySelector('#loads').data.filter((one) => one.type === 'cone')"
    browser.until(
        lambda: browser.run("return document.querySelector('#loads').dataset.drawn") != before
    )
    browser.until(lambda: any(one["v"][0] > 0.1 for one in browser.run(arrows)))


@pytest.mark.parametrize("name", ["link", "hot_bracket"])
@pytest.mark.parametrize("view", VIEWS)
def test_each_view_of_such_a_component_is_drawn_without_a_mistake(browser, name, view):
    browser.visit(f"#/c/{name}/{view}")
    browser.one("nav.tabs [aria-current]")
    browser.one("main .card")
    assert browser.mistakes() == []


def test_the_scene_plan_takes_loads_by_interface(browser):
    browser.visit("#/scene")
    browser.until(lambda: browser.all("fieldset input[type=checkbox]"))
    boxes = browser.all("fieldset.card label.check")
    next(box for box in boxes if box.text == "link").click()
    browser.named("form button", "Plan").click()
    browser.until(lambda: browser.all(".cards section.card"))
    assert "right.fx" in browser.one("main").text
