"""Viewers of a recording's estimates: one self-contained HTML page, or a file for Rerun."""

from viewshed.show.view.frames import AgentTrust, Frame, PackedFrame, pack_frame
from viewshed.show.view.html import write_page

__all__ = ["AgentTrust", "Frame", "PackedFrame", "pack_frame", "write_page"]
