"""The wire: types, fixed layouts, checksum, domain, and raw readers and writers."""
