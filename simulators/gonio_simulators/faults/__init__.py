"""Faults that the simulators inject, by name: what goes wrong on a real bench, on request and on record.

The language is in `spec`, the names in `catalogue`; `Injector` plugs the faults into a bench.
`read_fault_log` reads what ``--fault-log`` wrote.
"""

from gonio_simulators.faults.catalogue import CATALOGUE, fault_table
from gonio_simulators.faults.log import FaultLog, Injected, read_fault_log
from gonio_simulators.faults.spec import FaultSpec, parse_fault

__all__ = ["CATALOGUE", "FaultLog", "FaultSpec", "Injected", "fault_table", "parse_fault", "read_fault_log"]
