"""Every target, and its share of the inputs."""

from __future__ import annotations

from fuzzing.checked_lines import ModbusRtuReplies, ModbusTcpReplies, ZaberReplies, ZaberRepliesUnchecked
from fuzzing.outcome import Target
from fuzzing.simulator_lines import (
    CornerstoneRequests,
    ElliptecRequests,
    LockinRequests,
    RtuRequests,
    TcpRequests,
    ZaberRequests,
)
from fuzzing.text_files import PlanFiles, RigFiles, WireLogs
from fuzzing.text_lines import CS260Pipelined, CS260Replies, ElliptecReplies, SR830Replies

SHARES: dict[type[Target], float] = {
    ZaberReplies: 12.0,
    ZaberRepliesUnchecked: 6.0,
    ModbusRtuReplies: 16.0,
    ModbusTcpReplies: 6.0,
    ElliptecReplies: 8.0,
    CS260Replies: 4.0,
    CS260Pipelined: 4.0,
    SR830Replies: 8.0,
    ZaberRequests: 7.0,
    RtuRequests: 7.0,
    TcpRequests: 5.0,
    ElliptecRequests: 5.0,
    CornerstoneRequests: 5.0,
    LockinRequests: 5.0,
    WireLogs: 1.0,
    RigFiles: 0.5,
    PlanFiles: 0.5,
}
"""Per cent of all inputs."""
