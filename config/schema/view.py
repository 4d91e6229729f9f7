"""What a viewer shows, how often, and what it takes from a page: config/view.yaml."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from tonus.config.schema.base import Count, Positive, Section

Port = Annotated[int, Field(ge=0, le=65535)]


class View(Section):
    port: Port
    foxglove_port: Port
    foxglove_hz: Positive
    """of each topic there"""
    rate_hz: Positive
    """of the picture"""
    plot_hz: Positive
    """of new points in the plots"""
    sample_hz: Positive
    """samples of a signal in a plot"""
    window_s: Positive
    """shown in a plot"""
    path_s: Positive
    """of the reference's path, behind and ahead"""
    status_hz: Positive
    """questions to the daemon for state and self-test"""
    force_scale: Positive
    """m of an arrow per N"""
    watch_s: Positive
    """without a sign of the page that started it, after which the robot holds"""
    clients: Count
    connections: Count
    """open connections, before they have asked anything"""
    handshake_s: Positive
    message_bytes: Annotated[int, Field(ge=1024, le=1 << 20)]
    message_hz: Positive
    message_burst: Count
    events: Count
    """kept for a page that opens later"""
    log_memory_s: Positive
    """of a log, decoded at a time"""
