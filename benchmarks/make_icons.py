"""Draws the recorder's icons from ``client/page/shared/icon.svg``, with the browser that shows them.

Run it after changing the drawing: ``python benchmarks/make_icons.py``. Needs Debian's chromium.
"""

from pathlib import Path

from playwright.sync_api import sync_playwright

WEB = Path(__file__).parents[1] / "client" / "page"
BACKGROUND = "#0f6d52"
SAFE_SHARE = 0.8  # of a maskable icon that no mask cuts off
ICONS = {"icon-192.png": (192, 1.0), "icon-512.png": (512, 1.0), "icon-maskable-512.png": (512, SAFE_SHARE)}


def main() -> None:
    """Draw each icon."""
    drawing = (WEB / "shared" / "icon.svg").read_text(encoding="utf-8")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium")
        for name, (size_px, share) in ICONS.items():
            page = browser.new_page(viewport={"width": size_px, "height": size_px})
            colour = "transparent" if share == 1 else BACKGROUND
            style = f"margin:0;height:100vh;display:grid;place-items:center;background:{colour}"
            page.set_content(f'<body style="{style}">{drawing}<style>svg{{width:{100 * share}%}}</style></body>')
            page.screenshot(path=WEB / "record" / name, omit_background=True)
        browser.close()


if __name__ == "__main__":
    main()
