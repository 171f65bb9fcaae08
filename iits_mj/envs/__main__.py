"""Re-makes the manual pages of tasks and environments: `python -m iits_mj.envs [--pictures]`."""

import sys
from pathlib import Path

from iits_mj.envs import manual

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "environments"

FOLDER.mkdir(parents=True, exist_ok=True)
for name, page in manual.pages().items():
    (FOLDER / name).write_text(page, encoding="utf-8")
if "--pictures" in sys.argv[1:]:
    from iits_mj.envs import manual_pictures

    manual_pictures.draw(FOLDER / "images")
