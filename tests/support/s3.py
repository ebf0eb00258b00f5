"""An S3 emulator on the loopback."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator

BUCKET = "plant"
_CREDENTIALS = {
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_EC2_METADATA_DISABLED": "true",
}


@contextlib.contextmanager
def emulated_s3() -> Iterator[str]:
    """A server with an empty bucket; gives its HOST:PORT. Processes started meanwhile have its credentials."""
    import boto3
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    before = dict(os.environ)
    os.environ |= _CREDENTIALS
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    try:
        host, port = server.get_host_and_port()
        client = boto3.client("s3", endpoint_url=f"http://{host}:{port}", region_name="us-east-1")
        client.create_bucket(Bucket=BUCKET)
        yield f"{host}:{port}"
    finally:
        server.stop()
        for name in _CREDENTIALS:
            os.environ.pop(name)
        os.environ |= {name: before[name] for name in _CREDENTIALS if name in before}


def bundles_uri(endpoint: str, prefix: str) -> str:
    """Where a store's bundles lie there."""
    return f"s3://{BUCKET}/{prefix}?endpoint_override={endpoint}&scheme=http&region=us-east-1"
