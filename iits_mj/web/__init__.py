"""The viewer in a browser: `iits-mj view --web`, and pages that replay a drive in 3-D.

It needs no display and no OpenGL: the model is sent to the browser (viser, mjviser) and the
browser draws it. viser is loaded only when a viewer or a page is made.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from iits_mj.web.server import PORT, WebServer

if TYPE_CHECKING:
    from iits_mj.web.playback import replay_page
    from iits_mj.web.track import TrackObserver

__all__ = ["PORT", "TrackObserver", "WebServer", "replay_page"]


def __getattr__(name: str) -> Any:
    # Loads SUMO's recordings and bags only for replays.
    if name == "replay_page":
        from iits_mj.web import playback

        return playback.replay_page
    if name == "TrackObserver":
        from iits_mj.web import track

        return track.TrackObserver
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
