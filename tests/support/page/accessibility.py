"""Runs axe, a checker of accessibility, on a page."""

from pathlib import Path

from playwright.sync_api import Page

AXE = (Path(__file__).parent / "vendor" / "axe-core-4.14.1.min.js").read_text("utf-8")
# axe runs after short animations: colours within them have no meaning for contrast. It
# need not load the style sheets again, which only rules that are off would read.
RUN = """async () => {
  const moving = document.getAnimations()
    .filter((one) => one.effect.getComputedTiming().endTime < 2000);
  const rest = Promise.allSettled(moving.map((one) => one.finished));
  await Promise.race([rest, new Promise((late) => setTimeout(late, 2000))]);
  const options = { resultTypes: ["violations"], preload: false };
  const { violations } = await axe.run(document, options);
  return violations.flatMap(({ id, impact, nodes }) =>
    nodes.map(({ html, failureSummary }) => ({ id, impact, html, failureSummary })));
}"""
SERIOUS = ("serious", "critical")


def findings(page: Page) -> list[dict[str, str]]:
    """The findings of axe that are serious or critical."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE)
    violations: list[dict[str, str]] = page.evaluate(RUN)
    return [finding for finding in violations if finding["impact"] in SERIOUS]
