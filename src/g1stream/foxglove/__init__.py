"""What viewers get: protobuf messages, transforms and scenes made from samples."""
