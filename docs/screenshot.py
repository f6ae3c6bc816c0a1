"""Take the picture of a review for the README, without a display.

apt-get install -y --no-install-recommends mesa-vulkan-drivers libvulkan1 libgl1-mesa-dri libegl1
sensorgraph demo -o runs/picture
python docs/screenshot.py runs/picture/review.rrd docs/pages/pictures/review.png --time 640
"""

from __future__ import annotations

import argparse
import io
import sys
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

TOASTS = 14  # [s] for which start-up messages cover the right column
BAR = 37  # [pixels] height of the window's title bar, which is cut off


def main() -> None:
    """Open the review in the headless viewer of rerun and save a screenshot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("review", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--time", type=float, default=400.0, help="[s] of the run")
    options = parser.parse_args()
    viewer = Path(sys.executable).with_name("rerun")
    with ViewerClient.spawn(
        headless=True, port=9901, hide_welcome_screen=True, executable_path=str(viewer)
    ) as client:
        client.open(str(options.review.resolve()))
        while client.get_state().loading:
            time.sleep(0.2)
        client.set_time("time", duration=options.time, play_state="paused")
        time.sleep(TOASTS)
        picture = Image.open(io.BytesIO(client.take_screenshot())).convert("RGB")
        reports = [report for view in client.get_state().views for report in view.reports]
    picture = picture.crop((0, BAR, *picture.size))
    picture.quantize(colors=256, kmeans=2, dither=Image.Dither.NONE).save(options.picture, optimize=True)
    if reports:
        sys.exit(f"the viewer reports: {reports}")


if __name__ == "__main__":
    main()
