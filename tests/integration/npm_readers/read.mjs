// Reads an MCAP with the packages that Foxglove reads it with, and prints what it found as JSON.
//
//     node read.mjs FILE.mcap
//
// For each topic: how many messages there are, whether every log time equals its publish time, the
// first and last log time, and the first message decoded. Numbers beyond 2^53 are strings.

import { open } from "node:fs/promises";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";

const file = await open(process.argv[2]);

const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, size) => {
    const buffer = new Uint8Array(Number(size));
    await file.read({ buffer, position: Number(offset) });
    return buffer;
  },
};

const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: await loadDecompressHandlers(),
});

function decoderOf(schema) {
  if (schema.encoding === "protobuf") {
    const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
    const options = { longs: String, defaults: true };
    return (data) => type.toObject(type.decode(data), options);
  }
  const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
  const messageReader = new MessageReader(definition);
  return (data) => messageReader.readMessage(data);
}

const topics = {};
const decoders = new Map();
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  if (!decoders.has(channel.schemaId)) {
    decoders.set(channel.schemaId, decoderOf(reader.schemasById.get(channel.schemaId)));
  }
  const body = decoders.get(channel.schemaId)(message.data);
  const topic = (topics[channel.topic] ??= {
    count: 0,
    sameTimes: true,
    firstTime: String(message.logTime),
    first: body,
  });
  topic.count += 1;
  topic.sameTimes &&= message.logTime === message.publishTime;
  topic.lastTime = String(message.logTime);
  topic.last = body;
}
await file.close();
console.log(JSON.stringify({ topics, attachments: reader.attachmentIndexes.map((a) => a.name) }));
