"""A device database with one product, in the form that the vendor's library reads from a file.

The vendor's own file is not to be had without internet.  Tables and columns are those that the library asks
for; what stands in them describes the simulated stage.
"""

import sqlite3
from pathlib import Path

SCHEMA = 101
"""The version that zaber-motion 10 wants."""

_STEPS_PER_DEG = 66.6666666666666667  # full steps; the library multiplies by the resolution
_SPEED_UNIT = 1.6384

_TABLES: dict[str, tuple[str, list[tuple[object, ...]]]] = {
    "SchemaVersion": ("Version", [(SCHEMA,)]),
    "Products": (
        "Id, Name, DevPeriId, CarriageInertia, ForceOrTorqueConstant, MotorInertia, DriveRatio",
        [(1, "X-RST", 50952, None, None, None, None)],
    ),
    "ProductGroups": ("Id, MemberId", []),
    "ProductAttributes": (
        "Id, ProductId, VersionGroupId, ParentProductGroupId, ModificationMask, CapabilityGroupId, "
        "AsciiCommandGroupId, AsciiSettingValueGroupId, ContextualDimensionFunctionScaleGroupId, "
        "ServoControllerGroupId, ServoTuningId",
        [(1, 1, 1, None, 0, None, 1, 1, 1, None, None)],
    ),
    "VersionGroups": ("Id, MemberId", [(1, 1)]),
    "Versions": ("Id, Major, Minor, Build, NVSchemaVersion", [(1, 7, 35, 16151, 1)]),
    "Modifications": ("Mask, ProductIsModified, ParentIsModified, PeripheralIsModified", [(0, 0, 0, 0)]),
    "CapabilityGroups": ("Id, MemberId", []),
    "Capabilities": ("Id, Name", []),
    "SettingsCommon": (
        "Id, Name, TypeId, IsRealTimeSafe",
        [(1, "pos", 1, 1), (2, "maxspeed", 1, 1)],
    ),
    "Types": ("Id, Name, DecimalPlaces", [(1, "Int32", 0)]),
    "AsciiSettings": (
        "Id, SettingId, ContextualDimensionId, ReadLevel, WriteLevel, Visibility",
        [(1, 1, 1, 1, 1, 1), (2, 2, 2, 1, 1, 1)],
    ),
    "AsciiSettingValueGroups": ("Id, MemberId", [(1, 1)]),
    "AsciiSettingValueSubgroups": ("Id, MemberId", [(1, 1), (1, 2)]),
    "AsciiSettingValues": ("Id, AsciiSettingId, DefaultValue", [(1, 1, "0"), (2, 2, "1")]),
    "ContextualDimensionFunctionScaleGroups": ("Id, MemberId", [(1, 1), (1, 2)]),
    "ContextualDimensionFunctionScales": (
        "Id, ContextualDimensionId, UnitFunctionId, Scale",
        [(1, 1, 1, _STEPS_PER_DEG), (2, 2, 1, _STEPS_PER_DEG * _SPEED_UNIT)],
    ),
    "ContextualDimensions": (
        "Id, StableId, Name, DimensionId",
        [(1, 1, "Axis Position", 1), (2, 2, "Axis Velocity", 2)],
    ),
    "Dimensions": ("Id, Name", [(1, "Angle"), (2, "Angular Velocity")]),
    "UnitFunctions": ("Id, Name", [(1, "linear-resolution")]),
    "EnumMembers": ("EnumTypeId, Name", []),
    "AsciiCommandGroups": ("Id, MemberId", [(1, 1)]),
    "AsciiCommandSubgroups": ("Id, MemberId", [(1, 3), (1, 5)]),
    "AsciiCommands": (
        "Id, ParentId, Name, TypeId, HasCallback, ContextualDimensionId, Arity, EnumTypeId",
        [
            (1, None, "move", None, 0, None, None, None),
            (2, 1, "abs", None, 0, None, None, None),
            (3, 2, "position", 1, 1, 1, None, None),
            (4, 1, "vel", None, 0, None, None, None),
            (5, 4, "velocity", 1, 1, 2, None, None),
        ],
    ),
    "ServoControllerGroups": ("Id, MemberId", []),
    "ServoControllers": ("Id, Name, Version", []),
    "ServoTunings": ("Id, TunerGuidanceData", []),
}


def write_database(path: Path) -> None:
    """Write the database."""
    connection = sqlite3.connect(path)
    try:
        for name, (columns, rows) in _TABLES.items():
            connection.execute(f"CREATE TABLE SwWeb_{name} ({columns})")
            places = ", ".join("?" * (columns.count(",") + 1))
            connection.executemany(f"INSERT INTO SwWeb_{name} VALUES ({places})", rows)
        connection.commit()
    finally:
        connection.close()
