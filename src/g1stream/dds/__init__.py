"""DDS: message types, CDR layouts, checksum, domain participants, and raw readers and writers."""
