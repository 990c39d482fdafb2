"""A map for other programs, in every format that it can be exported to."""

from rholoc.exports.formats import ExportFormat, export_map, parse_features

__all__ = ["ExportFormat", "export_map", "parse_features"]
