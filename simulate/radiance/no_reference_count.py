"""Arrays whose references compiled loops do not count: for a few numbers a ray, counting costs more than the work."""

from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array


def _without_reference_count(typingctx: Any, value: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _strip_reference_count(context, builder, signature.args[0], args[0])

    return value(value), codegen


# Returns an array, or a tuple of arrays, tuples and numbers, whose references are not counted. The caller holds them:
# what a loop itself has made must not pass here, for it would be given back while in use.
without_reference_count: Any = intrinsic(_without_reference_count)


def _strip_reference_count(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        kinds: Any = kind
        parts = [
            _strip_reference_count(context, builder, part, builder.extract_value(value, i))
            for i, part in enumerate(kinds)
        ]
        return context.make_tuple(builder, kind, parts)
    return value
