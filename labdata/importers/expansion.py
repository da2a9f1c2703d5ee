"""How large a packed picture may be: what its header states beyond that, its bytes cannot hold."""

from labdata.errors import BadInput
from labdata.importers.thresholds import MOST_EXPANSION


def require_possible(stated_bytes: int, file_bytes: int, what: str) -> None:
    """Refuse a picture whose header states more pixels than its file can hold, before memory is asked for them.

    Parameters
    ----------
    stated_bytes
        Bytes that the pixels take once unpacked, as the header states.
    file_bytes
        Bytes of the file.
    what
        The file, for the sentence.
    """
    if stated_bytes > MOST_EXPANSION * file_bytes:
        raise BadInput(f"a picture must fit into its file, got {stated_bytes} bytes of pixels stated by {what}")
