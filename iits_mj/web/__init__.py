"""The viewer in a browser: `iits-mj view --web`, and pages that replay a drive in 3-D.

It needs no display and no OpenGL: the model is sent to the browser (viser, mjviser) and the
browser draws it. viser is loaded only when a viewer or a page is made.
"""

from iits_mj.web.server import PORT, WebServer

__all__ = ["PORT", "WebServer"]
