"""Something to watch: a recording's estimates as one HTML page that needs no network and no server."""

from viewshed.show.view.frames import AgentTrust, Frame, PackedFrame, pack_frame
from viewshed.show.view.html import write_page

__all__ = ["AgentTrust", "Frame", "PackedFrame", "pack_frame", "write_page"]
