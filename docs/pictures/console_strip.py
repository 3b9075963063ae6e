"""The film strip of the console in the README, from screenshots of its tests (needs Chromium):

TRIMTAB_SCREENSHOTS=shots pytest -m alone -n 0 tests/console/test_browser.py
python docs/pictures/console_strip.py shots
"""

import sys
from pathlib import Path

from PIL import Image

FRAMES = ("forward", "tuned", "link-lost", "desk-light")
SIZE = (640, 360)

if __name__ == "__main__":
    shots = Path(sys.argv[1])
    strip = Image.new("RGB", (2 * SIZE[0], 2 * SIZE[1]))
    for k, name in enumerate(FRAMES):
        frame = Image.open(shots / f"{name}.png").convert("RGB").resize(SIZE, Image.Resampling.LANCZOS)
        strip.paste(frame, (k % 2 * SIZE[0], k // 2 * SIZE[1]))
    strip.quantize(64).save(Path(__file__).with_name("console.png"), optimize=True)
