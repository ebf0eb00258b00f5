"""Whether exported QIF documents are valid by the official schema, whose owner hands it out.

    python benchmarks/validate_qif.py SCHEMA_FOLDER FILE.qif …

The folder has QIFApplications and QIFLibrary in it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import xmlschema
from lxml import etree


class Local(etree.Resolver):
    """Gives the schema of signatures, which QIF names by its address, from xmlschema's own files."""

    def resolve(self, url: str, _: object, context: object) -> object:
        """The file for an address; None for others."""
        own = next(Path(xmlschema.__file__).parent.rglob("xmldsig-core-schema.xsd"))
        return self.resolve_filename(str(own), context) if "xmldsig" in url else None


def main() -> int:
    """Validate and print what is wrong."""
    folder, *files = map(Path, sys.argv[1:])
    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Local())
    schema = etree.XMLSchema(etree.parse(str(folder / "QIFApplications" / "QIFDocument.xsd"), parser))
    for file in files:
        valid = schema.validate(etree.parse(str(file)))
        print(f"{file}: {'valid' if valid else schema.error_log}")
        if not valid:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
