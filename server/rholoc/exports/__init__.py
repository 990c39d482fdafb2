"""Export of maps to the formats of other programs."""

from rholoc.exports.formats import ExportFormat, export_map, parse_features

__all__ = ["ExportFormat", "export_map", "parse_features"]
