"""Why a connection failed, in the words of messages."""

_OF_PLAIN_HTTP = ("WRONG_VERSION_NUMBER", "PACKET_LENGTH_TOO_LONG")  # by the version of OpenSSL


def why(error: Exception) -> str:
    """Return the text of a library's error; of TLS with a service that has none what that means."""
    text = str(error) or repr(error)
    if any(reason in text for reason in _OF_PLAIN_HTTP):
        return (
            f"what answers there does not speak TLS: is it http:// in place of https://? ({text})"
        )
    return text
