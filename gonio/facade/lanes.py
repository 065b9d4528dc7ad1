"""Eight boxes, or four primitives, against one ray at a time.

LLVM's vectoriser decides for itself what it packs, so the two tests of the tree are written as vectors of
float32 in its language.  On a machine with narrower registers a vector becomes two.

Both are filters that never lose a hit; the test of a primitive that counts is made in float64
(`gonio.facade.intersect`).  With the unit roundoff ``u = 2^-24`` their error bounds are:

Boxes.  A side at x is met at ``x/d - o/d``; o/d is rounded up for the near side and down for the far one.
The inverse direction and the result lose one u each, so the far distance is stretched by 1 + 10 u.  Without
fused operations x/d loses another u, which is u x in metres and less than the boxes are padded.

Primitives.  ``t = (c - n.p)/(n.d)``: numerator and denominator err by at most 8 u (E + p) and 6 u, so t errs
by ``(8 u (E + p) + 6 u t)/(n.d)``; 32 u (E + p + t)/(n.d) covers it and what the coordinates of the hit lose
in addition.  NaN and infinity, of rays in the plane, are never rejected.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

STACK = 512
"""Entries of the traversal's stack, 8 bytes each; `gonio.facade.bvh` keeps its trees that shallow."""

NODE_ROWS = 7
"""float32 rows of 8 in a node: low x, y, z, high x, y, z of its children, and the children as int32."""

BLOCK_ROWS = 15
"""float32 rows of 4 in a block of a leaf: n, c; dual_u, c_u; dual_v, c_v; largest dual; limit of a + b; and
as int32 the first primitive, the mask of those that there are, and whether another block follows."""

_BOXES, _PRIMITIVES = 8, 4
_SINGLE, _INT32, _INT64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_STRETCH = 1.0 + 10.0 * 2.0**-24
_SLACK = 2e-6  # of an edge: widened edges, and the rounding of a and b near one
_FUSED = ("contract",)


def _intrinsic(function: Callable[..., Any]) -> Callable[..., Any]:
    return intrinsic(function)  # type: ignore[no-any-return]


@_intrinsic
def pointer(_typing: Any, array: Any) -> Any:
    """Return the address of an array's first element: indexing it counts no references."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, value=args[0]).data

    return types.CPointer(array.dtype)(array), build


@_intrinsic
def frame(_typing: Any) -> Any:
    """Return room in the caller's frame: `STACK` int64; distances of eight boxes and of four primitives."""

    def build(context: Any, builder: Any, signature: Any, _args: Any) -> Any:
        with builder.goto_entry_block():  # numba's own helper would clear all of it for every ray
            entries = builder.alloca(ir.ArrayType(_INT64, STACK))
            enters = builder.alloca(ir.ArrayType(_INT32, _BOXES))
            latest = builder.alloca(ir.ArrayType(_SINGLE, _PRIMITIVES))
        entries.align = enters.align = latest.align = 64
        places = [
            builder.bitcast(room, of.as_pointer())
            for room, of in ((entries, _INT64), (enters, _INT32), (latest, _SINGLE))
        ]
        return context.make_tuple(builder, signature.return_type, places)

    rooms = types.int64, types.uint32, types.float32
    return types.Tuple([types.CPointer(of) for of in rooms])(), build


@_intrinsic
def as_int32(_typing: Any, start: Any) -> Any:
    """Return the address of float32 as one of int32."""

    def build(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], _INT32.as_pointer())

    return types.CPointer(types.int32)(start), build


@_intrinsic
def lowest(_typing: Any, mask: Any) -> Any:
    """Return the number of the lowest bit of `mask`, which is not 0."""

    def build(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), build


@_intrinsic
def float_bits(_typing: Any, x: Any) -> Any:
    """Return the bits of a float32 >= 0 as an int64, which sorts as the number does."""

    def build(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(32)), ir.IntType(64))

    return types.int64(types.float32), build


def _vector(of: Any, lanes: int) -> Any:
    return ir.VectorType(of, lanes)


def _all(builder: Any, scalar: Any, lanes: int) -> Any:
    """Return `lanes` times `scalar`."""
    none = ir.Constant(_vector(scalar.type, lanes), ir.Undefined)
    one = builder.insert_element(none, scalar, _INT32(0))
    return builder.shuffle_vector(one, none, ir.Constant(_vector(_INT32, lanes), [0] * lanes))


def _constant(value: float, lanes: int) -> Any:
    return ir.Constant(_vector(_SINGLE, lanes), [value] * lanes)


def _row(builder: Any, base: Any, offset: Any, lanes: int) -> Any:
    place = builder.bitcast(builder.gep(base, [offset]), _vector(_SINGLE, lanes).as_pointer())
    return builder.load(place, align=4)


def _larger(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _smaller(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _size(builder: Any, a: Any) -> Any:
    lanes = a.type.count
    without_sign = ir.Constant(_vector(_INT32, lanes), [0x7FFFFFFF] * lanes)
    bits = builder.bitcast(a, _vector(_INT32, lanes))
    return builder.bitcast(builder.and_(bits, without_sign), a.type)


def _mask(builder: Any, lanes: Any) -> Any:
    return builder.zext(builder.bitcast(lanes, ir.IntType(lanes.type.count)), _INT64)


def _add(builder: Any, a: Any, b: Any) -> Any:
    return builder.fadd(a, b, flags=_FUSED)


def _times(builder: Any, a: Any, b: Any) -> Any:
    return builder.fmul(a, b, flags=_FUSED)


def _dot(builder: Any, a: Any, b: Any) -> Any:
    total = _times(builder, a[0], b[0])
    for i in (1, 2):
        total = _add(builder, total, _times(builder, a[i], b[i]))
    return total


@_intrinsic
def boxes(_typing: Any, nodes: Any, node: Any, rows: Any, ray: Any, limit: Any, distances: Any) -> Any:
    """Return the mask of the children of `node` whose boxes the ray meets within `limit`.

    Writes the bits of the distance at which each box is entered: as integers they sort as the distances do.
    `rows` are the places in a node of the near x, y, z (0 or 24, 8 or 32, 16 or 40), and `ray` is for each
    axis ``(inverse direction, near origin times it, far origin times it)``.
    """

    def build(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        nodes, node, rows, ray, limit, distances = args
        base = builder.mul(node, _INT64(NODE_ROWS * _BOXES))
        enter, leave = _constant(0.0, _BOXES), _all(builder, limit, _BOXES)
        for axis in range(3):
            row = builder.extract_value(rows, axis)
            other = builder.sub(_INT64(_BOXES * (2 * axis + 3)), row)
            scale, near, far = (
                _all(builder, builder.extract_value(ray, [axis, i]), _BOXES) for i in range(3)
            )
            a = _times(builder, _row(builder, nodes, builder.add(base, row), _BOXES), scale)
            b = _times(builder, _row(builder, nodes, builder.add(base, other), _BOXES), scale)
            enter = _larger(builder, builder.fsub(a, near, flags=_FUSED), enter)
            leave = _smaller(builder, builder.fsub(b, far, flags=_FUSED), leave)
        hit = builder.fcmp_ordered("<=", enter, builder.fmul(leave, _constant(_STRETCH, _BOXES)))
        builder.store(enter, builder.bitcast(distances, enter.type.as_pointer()), align=32)
        return _mask(builder, hit)

    return types.int64(nodes, types.int64, rows, ray, types.float32, distances), build


@_intrinsic
def candidates(
    _typing: Any, blocks: Any, block: Any, p: Any, d: Any, reach: Any, limit: Any, latest: Any
) -> Any:
    """Return the mask of the primitives of a leaf that the ray may meet for 0 < t <= limit.

    Writes for each the largest t at which it can be met, or NaN.  `reach` is 32 u times the largest
    coordinate that origin and scene have, m.
    """

    def build(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        blocks, block, p, d, reach, limit, latest = args
        n = _PRIMITIVES
        base = builder.mul(block, _INT64(BLOCK_ROWS * n))
        row = [_row(builder, blocks, builder.add(base, _INT64(n * i)), n) for i in range(14)]
        p = [_all(builder, builder.extract_value(p, i), n) for i in range(3)]
        d = [_all(builder, builder.extract_value(d, i), n) for i in range(3)]
        zero, one = _constant(0.0, n), _constant(1.0, n)

        height = builder.fsub(row[3], _dot(builder, row[0:3], p), flags=_FUSED)
        steep = builder.fdiv(one, _dot(builder, row[0:3], d))
        t = builder.fmul(height, steep)
        span = _add(
            builder,
            _times(builder, _size(builder, t), _constant(32.0 * 2.0**-24, n)),
            _all(builder, reach, n),
        )
        error = builder.fmul(span, _size(builder, steep))
        x = [_add(builder, p[i], _times(builder, t, d[i])) for i in range(3)]
        a = _add(builder, _dot(builder, row[4:7], x), row[7])
        b = _add(builder, _dot(builder, row[8:11], x), row[11])
        edge = _add(builder, _times(builder, row[12], error), _constant(_SLACK, n))
        low, high = builder.fsub(zero, edge), builder.fadd(one, edge)
        missed = builder.fcmp_ordered("<", t, builder.fsub(zero, error))
        for less, more in (
            (builder.fadd(_all(builder, limit, n), error), t),
            (a, low),
            (b, low),
            (high, a),
            (high, b),
            (builder.fadd(row[13], builder.fadd(edge, edge)), builder.fadd(a, b)),
        ):
            missed = builder.or_(missed, builder.fcmp_ordered("<", less, more))
        last = _add(builder, t, _times(builder, error, _constant(1.01, n)))  # and coplanar ones behind it
        builder.store(last, builder.bitcast(latest, last.type.as_pointer()), align=16)
        return _mask(builder, builder.not_(missed))

    return types.int64(blocks, types.int64, p, d, types.float32, types.float32, latest), build
