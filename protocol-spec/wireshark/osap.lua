-- OSAP in Wireshark: packets of link type USER0 (147), as osap captures write them, and on a UDP port of your choice.
--
--   wireshark -X lua_script:osap.lua capture.pcapng
--
-- To have it always, put it into the folder "Personal Lua Plugins" of Help > About > Folders. A UDP port is set in the protocol's
-- preferences, or with -o osap.udp_port:4100.
--
-- It shows what ../spec says, in the same words: each problem is an expert item that begins with the name of the drop it causes.
-- Plain Lua 5.2 to 5.4: no bit library, since those differ.

local osap = Proto("osap", "OSAP")

local NETRESPONDER = 0
local ROUTE_OFFSET = 5
local VERSION = 1

local TRANSPORTS = { [0] = "datagram", [1] = "sequenced", [2] = "segmented" }
local KINDS = { [0] = "request", [1] = "reply", [2] = "refusal" }
local CONTROLS = { [0] = "data", [1] = "acknowledgement", [2] = "refusal" }
local SEGMENT_REASONS = { [1] = "busy", [2] = "too long" }
local SYSTEM_KEYS = {
  [0] = "time request", [1] = "time reply", [2] = "link announcement", [3] = "trace", [4] = "log", [5] = "firmware",
  [6] = "halt",
}
local ANNOUNCEMENT = 2
local HALT, HALT_BYTES = 6, 26
local ACTIONS = { [0] = "stop", [1] = "resume" }
-- Lengths of a time request and of a time reply.
local TIME_REPLY_BYTES = 72
local TIME_BYTES = { [0] = 7, [1] = TIME_REPLY_BYTES }
local QUERIES = {
  [1] = "runtime information", [2] = "runtime type name", [3] = "runtime name", [4] = "set runtime name",
  [5] = "link information", [6] = "port information", [7] = "debug messages", [8] = "set debug verbosity",
  [9] = "time controller configuration", [10] = "set time controller configuration", [11] = "counters",
  [12] = "time status", [13] = "time of a link", [14] = "set time asymmetry",
}
local REFUSALS = {
  [1] = "unknown query", [2] = "another version", [3] = "body not readable", [4] = "no such index", [5] = "value out of range",
  [6] = "answer too long",
}

local f = {
  pointer = ProtoField.uint8("osap.pointer", "Pointer"),
  ttl = ProtoField.uint16("osap.ttl", "Time to live (µs)"),
  mtu = ProtoField.uint16("osap.mtu", "MTU (bytes)"),
  taken = ProtoField.string("osap.step.taken", "Step taken"),
  current = ProtoField.string("osap.step.current", "Current instruction"),
  to_come = ProtoField.string("osap.step.to_come", "To come"),
  link = ProtoField.uint8("osap.link", "Link gateway"),
  bus = ProtoField.uint8("osap.bus", "Bus gateway"),
  drop = ProtoField.uint8("osap.drop", "Bus drop"),
  source = ProtoField.uint16("osap.port.source", "Source port"),
  destination = ProtoField.uint16("osap.port.destination", "Destination port"),
  system = ProtoField.uint8("osap.system", "System message", base.DEC, SYSTEM_KEYS),
  transport = ProtoField.uint8("osap.transport", "Transport", base.DEC, TRANSPORTS),
  kind = ProtoField.uint8("osap.kind", "Kind", base.DEC, KINDS),
  sequence = ProtoField.uint16("osap.sequence", "Sequence number"),
  query = ProtoField.uint8("osap.query", "Query", base.DEC, QUERIES),
  version = ProtoField.uint8("osap.version", "Version"),
  refusal = ProtoField.uint8("osap.refusal", "Reason", base.DEC, REFUSALS),
  scan = ProtoField.uint32("osap.scan", "Scan"),
  visit = ProtoField.uint16("osap.visit", "Visit"),
  name = ProtoField.string("osap.name", "Name"),
  control = ProtoField.uint8("osap.segment.control", "Control", base.DEC, CONTROLS),
  message = ProtoField.uint8("osap.segment.message", "Message"),
  index = ProtoField.uint16("osap.segment.index", "Index"),
  count = ProtoField.uint16("osap.segment.count", "Count"),
  next = ProtoField.uint16("osap.segment.next", "Wanted next"),
  reason = ProtoField.uint8("osap.segment.reason", "Reason", base.DEC, SEGMENT_REASONS),
  unique_id = ProtoField.bytes("osap.announcement.unique_id", "Unique id"),
  boot_epoch = ProtoField.uint32("osap.announcement.boot_epoch", "Boot epoch"),
  wants_answer = ProtoField.bool("osap.announcement.wants_answer", "Wants an answer"),
  own_drop = ProtoField.uint8("osap.announcement.drop", "Own drop"),
  payload = ProtoField.bytes("osap.payload", "Payload"),
}
osap.fields = f

local function problem(cause)
  local abbreviation = "osap." .. cause:gsub("-", "_")
  return ProtoExpert.new(abbreviation, cause, expert.group.MALFORMED, expert.severity.ERROR)
end

local CAUSES = {
  "short", "pointer-outside", "instruction-cut", "transport-missing", "over-mtu", "expired", "unknown-transport",
  "transport-malformed", "segment-invalid", "unknown-system-key", "system-malformed", "query-malformed", "not-forwarding",
}
local experts, problems = {}, {}
for _, cause in ipairs(CAUSES) do
  problems[cause] = problem(cause)
  table.insert(experts, problems[cause])
end
-- refused queries are answered, so they are no errors of the packet
problems["refused"] = ProtoExpert.new("osap.refused", "refused", expert.group.REQUEST_CODE, expert.severity.WARN)
problems["bad-frame"] = ProtoExpert.new("osap.bad_frame", "bad frame", expert.group.CHECKSUM, expert.severity.ERROR)
problems["no-way-back"] = ProtoExpert.new("osap.no_way_back", "no way back", expert.group.PROTOCOL, expert.severity.WARN)
table.insert(experts, problems["refused"])
table.insert(experts, problems["no-way-back"])
table.insert(experts, problems["bad-frame"])
osap.experts = experts

osap.prefs.udp_port = Pref.uint("UDP port", 0, "Port whose datagrams are OSAP packets; 0 for none")

-- Set by a capture for frames that gave no packet, `epb_flags` bits 24 to 31; the frame's comment then names the drop.
local flags = Field.new("frame.packet_flags")
local LINK_ERRORS = 2 ^ 24

-- What one packet's parts share.
local Context = {}
Context.__index = Context

function Context:wrong(item, cause, what)
  item:add_proto_expert_info(problems[cause], cause .. ": " .. what)
  self.causes[#self.causes + 1] = cause
end

function Context:left(at)
  return self.tvb:len() - at
end

-- The rest of the packet, where nothing more can be said of it.
function Context:payload(tree, at)
  if self:left(at) > 0 then
    tree:add(f.payload, self.tvb(at))
  end
end

-- Bytes of an instruction, told by the top two bits of its first byte.
local function width(first)
  if first < 0x80 then return 1 end
  if first < 0xc0 then return 2 end
  return 3
end

-- The whole instruction at `at`, or nil where it is cut or the packet has ended.
local function decode(tvb, at)
  if at >= tvb:len() then return nil end
  local first = tvb(at, 1):uint()
  local instruction = { at = at, width = width(first), opcode = math.floor(first / 64) }
  if at + instruction.width > tvb:len() then return nil end
  if instruction.opcode == 0 then
    instruction.key = first % 64
    local name = SYSTEM_KEYS[instruction.key]
    instruction.text = "system " .. (name or instruction.key)
  elseif instruction.opcode == 1 then
    instruction.gateway = first % 64
    instruction.text = "link " .. instruction.gateway
  elseif instruction.opcode == 2 then
    instruction.gateway = first % 64
    instruction.drop = tvb(at + 1, 1):uint()
    instruction.text = string.format("bus %d drop %s", instruction.gateway, instruction.drop == 255 and "all" or instruction.drop)
  else
    local bits = tvb(at, 3):uint()
    instruction.source = math.floor(bits / 2048) % 2048
    instruction.destination = bits % 2048
    instruction.text = string.format("port %d→%d", instruction.source, instruction.destination)
  end
  return instruction
end

local function forwards(instruction)
  return instruction.opcode == 1 or instruction.opcode == 2
end

local function show(context, tree, field, instruction)
  local range = context.tvb(instruction.at, instruction.width)
  local item = tree:add(field, range, instruction.text)
  if instruction.opcode == 0 then
    item:add(f.system, range, instruction.key)
  elseif instruction.opcode == 1 then
    item:add(f.link, range, instruction.gateway)
  elseif instruction.opcode == 2 then
    item:add(f.bus, range(0, 1), instruction.gateway)
    item:add(f.drop, range(1, 1))
  else
    item:add(f.source, range, instruction.source)
    item:add(f.destination, range, instruction.destination)
  end
  return item
end

-- A number of at most `bits` bits: seven a byte, low ones first, the top bit where more follow. Returns it and where it ends.
local function varint(tvb, at, bits)
  local value, scale = 0, 1
  for _ = 1, math.ceil(bits / 7) do
    if at >= tvb:len() then return nil end
    local byte = tvb(at, 1):uint()
    value = value + (byte % 128) * scale
    at = at + 1
    if byte < 128 then
      if value >= 2 ^ bits then return nil end
      return math.floor(value), at
    end
    scale = scale * 128
  end
  return nil
end

-- [SYS-02], [SYS-05]: version, unique id, boot epoch, whether an answer is wanted, own drop.
local function announcement(context, tree, at)
  local tvb, start = context.tvb, at
  local function malformed(what)
    context:wrong(tree, "system-malformed", what)
    context:payload(tree, at)
  end
  if context:left(at) < 13 then return malformed("the announcement is cut short") end
  local version = tree:add(f.version, tvb(at, 1))
  tree:add(f.unique_id, tvb(at + 1, 12))
  at = at + 13
  local epoch, epoch_end = varint(tvb, at, 32)
  if not epoch then return malformed("the boot epoch does not read") end
  tree:add(f.boot_epoch, tvb(at, epoch_end - at), epoch)
  at = epoch_end
  if context:left(at) < 2 then return malformed("the announcement is cut short") end
  local wants, has_drop = tvb(at, 1):uint(), tvb(at + 1, 1):uint()
  if wants > 1 or has_drop > 1 then return malformed("a flag is neither 0 nor 1") end
  tree:add(f.wants_answer, tvb(at, 1))
  at = at + 2
  if has_drop == 1 then
    if context:left(at) < 1 then return malformed("the announcement is cut short") end
    tree:add(f.own_drop, tvb(at, 1))
    at = at + 1
  end
  if context:left(at) > 0 then return malformed("bytes are left over") end
  if tvb(start, 1):uint() ~= VERSION then
    context:wrong(version, "system-malformed", "another version is served")
  end
end

-- [TIM-01], [TIM-02]: of fixed width; version and sequence come first. The command `osap decode` shows the rest.
local function time_message(context, tree, at, width)
  local tvb = context.tvb
  if context:left(at) ~= width then
    context:wrong(tree, "system-malformed", "the message is not " .. width .. " bytes long")
  else
    local version = tree:add(f.version, tvb(at, 1))
    if tvb(at, 1):uint() ~= VERSION then
      context:wrong(version, "system-malformed", "another version is served")
    end
    tree:add(f.sequence, tvb(at + 1, 1))
    if width == TIME_REPLY_BYTES then
      local tier, flags = tvb(at + 44, 1):uint(), tvb(at + 58, 1):uint()
      if tier > 64 and tier ~= 255 then
        context:wrong(tree, "system-malformed", "no route has " .. tier .. " steps")
      elseif flags > 15 then
        context:wrong(tree, "system-malformed", "a flag has no meaning")
      end
    end
    at = at + 2
  end
  context:payload(tree, at)
end

-- [MOT-20]: version, action, sequence, epoch, origin.
local function halt(context, tree, at)
  local tvb = context.tvb
  if context:left(at) ~= HALT_BYTES then
    context:wrong(tree, "system-malformed", "the halt is not " .. HALT_BYTES .. " bytes long")
    return context:payload(tree, at)
  end
  local version, action = tree:add(f.version, tvb(at, 1)), tvb(at + 1, 1):uint()
  if tvb(at, 1):uint() ~= VERSION then
    context:wrong(version, "system-malformed", "another version is served")
  elseif not ACTIONS[action] then
    context:wrong(tree, "system-malformed", "an action is 0, stop, or 1, resume")
  end
  context:payload(tree, at + 1)
end

local function system(context, tree, instruction, item)
  local at = instruction.at + instruction.width
  if instruction.key == ANNOUNCEMENT then
    announcement(context, tree, at)
  elseif TIME_BYTES[instruction.key] then
    time_message(context, tree, at, TIME_BYTES[instruction.key])
  elseif instruction.key == HALT then
    halt(context, tree, at)
  else
    if not SYSTEM_KEYS[instruction.key] then
      context:wrong(item, "unknown-system-key", "system message " .. instruction.key .. " means nothing")
    end
    context:payload(tree, at)
  end
end

-- Bodies that are shown: scan ids of requests, names of both. The command `osap decode` shows all of them.
local function query_body(context, tree, at, kind, key)
  local tvb = context.tvb
  if kind == 0 and key == 1 then
    local scan, scan_end = varint(tvb, at, 32)
    local visit, visit_end = nil, nil
    if scan then visit, visit_end = varint(tvb, scan_end, 16) end
    if visit then
      tree:add(f.scan, tvb(at, scan_end - at), scan)
      tree:add(f.visit, tvb(scan_end, visit_end - scan_end), visit)
      at = visit_end
    end
  elseif (kind == 1 and (key == 2 or key == 3)) or (kind == 0 and key == 4) then
    local length, text = varint(tvb, at, 32)
    if length and length <= context:left(text) then
      local range = tvb(at, text - at + length)
      tree:add(f.name, range, length > 0 and tvb(text, length):string(ENC_UTF_8) or "")
      at = text + length
    end
  end
  context:payload(tree, at)
end

-- [DSC-01], [DSC-02]
local function netresponder(context, tree, at, kind)
  local tvb = context.tvb
  if context:left(at) < 2 then
    context:payload(tree, at)
    if kind == 0 then
      context:wrong(tree, "query-malformed", "a query has at least a key and a version")
    end
    return
  end
  local key, version = tvb(at, 1):uint(), tvb(at + 1, 1):uint()
  local key_item = tree:add(f.query, tvb(at, 1))
  local version_item = tree:add(f.version, tvb(at + 1, 1))
  context.info = context.info .. " " .. (QUERIES[key] or ("query " .. key))
  at = at + 2
  if kind == 2 then
    if context:left(at) > 0 then
      local reason = tvb(at, 1):uint()
      tree:add(f.refusal, tvb(at, 1))
      context.info = context.info .. ": " .. (REFUSALS[reason] or ("reason " .. reason))
      at = at + 1
    end
    return context:payload(tree, at)
  end
  if kind == 0 and not QUERIES[key] then
    context:wrong(key_item, "refused", "the node answers with refusal 1, unknown query")
  elseif kind == 0 and version ~= VERSION then
    context:wrong(version_item, "refused", "the node answers with refusal 2, another version")
  end
  query_body(context, tree, at, kind, key)
end

-- [TRN-03]
local function sequenced(context, tree, at, port)
  local tvb = context.tvb
  if context:left(at) < 2 then
    context:payload(tree, at)
    return context:wrong(tree, "transport-malformed", "the sequence word is cut short")
  end
  local word = tvb(at, 2):le_uint()
  local kind, sequence = math.floor(word / 16384), word % 16384
  local item = tree:add(f.kind, tvb(at, 2), kind)
  tree:add(f.sequence, tvb(at, 2), sequence)
  context.info = string.format("%s %s #%d", context.info, KINDS[kind] or "kind 3", sequence)
  if not KINDS[kind] then
    context:wrong(item, "transport-malformed", "kind 3 means nothing")
  elseif (kind == 0 and port.destination == NETRESPONDER) or (kind ~= 0 and port.source == NETRESPONDER) then
    return netresponder(context, tree, at + 2, kind)
  end
  context:payload(tree, at + 2)
end

-- [TRN-07], [TRN-08]
local function segmented(context, tree, at)
  local tvb = context.tvb
  local function malformed(what)
    context:payload(tree, at)
    context:wrong(tree, "transport-malformed", what)
  end
  if context:left(at) < 2 then return malformed("the segment header is cut short") end
  local control, message = tvb(at, 1):uint(), tvb(at + 1, 1):uint()
  local needs = ({ [0] = 6, [1] = 4, [2] = 3 })[control]
  if not needs then return malformed("control " .. control .. " means nothing") end
  if context:left(at) < needs then return malformed("the segment header is cut short") end
  tree:add(f.control, tvb(at, 1))
  tree:add(f.message, tvb(at + 1, 1))
  context.info = string.format("%s %s of message %d", context.info, CONTROLS[control], message)
  if control == 0 then
    local index, count = tvb(at + 2, 2):le_uint(), tvb(at + 4, 2):le_uint()
    local item = tree:add_le(f.index, tvb(at + 2, 2))
    tree:add_le(f.count, tvb(at + 4, 2))
    context.info = string.format("%s, %d of %d", context.info, index, count)
    if index >= count then
      context:wrong(item, "segment-invalid", "the index is not below the count")
    end
  elseif control == 1 then
    tree:add_le(f.next, tvb(at + 2, 2))
  else
    local reason = tvb(at + 2, 1):uint()
    local item = tree:add(f.reason, tvb(at + 2, 1))
    if not SEGMENT_REASONS[reason] then
      context:wrong(item, "transport-malformed", "reason " .. reason .. " means nothing")
    end
  end
  context:payload(tree, at + needs)
end

-- [PKT-05], [TRN-01]
local function transport(context, tree, port)
  local tvb, at = context.tvb, port.at + port.width
  if context:left(at) == 0 then
    return context:wrong(tree, "transport-missing", "the packet ends before its transport key")
  end
  local key = tvb(at, 1):uint()
  local item = tree:add(f.transport, tvb(at, 1))
  context.info = context.info .. "  " .. (TRANSPORTS[key] or ("transport " .. key))
  at = at + 1
  if key == 1 then
    sequenced(context, tree, at, port)
  elseif key == 2 then
    segmented(context, tree, at)
  else
    if not TRANSPORTS[key] then
      context:wrong(item, "unknown-transport", "there is no transport " .. key)
    elseif port.destination == NETRESPONDER then
      context:wrong(item, "query-malformed", "port 0 takes sequenced requests only")
    end
    context:payload(tree, at)
  end
end

-- The steps before the pointer: the way back.
local function taken(context, tree, pointer)
  local at = ROUTE_OFFSET
  while at < pointer do
    local instruction = decode(context.tvb, at)
    if not instruction or not forwards(instruction) or at + instruction.width > pointer then
      local item = tree:add(f.taken, context.tvb(at, pointer - at), "not whole steps")
      return context:wrong(item, "no-way-back", "the bytes before the pointer are no steps taken")
    end
    show(context, tree, f.taken, instruction)
    at = at + instruction.width
  end
end

-- From the pointer to the end of the route, and what follows it.
local function route(context, tree, pointer)
  local at, texts = pointer, {}
  while true do
    local instruction = decode(context.tvb, at)
    if not instruction then
      local ended = context:left(at) <= 0
      context.info = table.concat(texts, " › ")
      context:payload(tree, at)
      local cause = ended and "pointer-outside" or "instruction-cut"
      return context:wrong(tree, cause, "the route breaks off at byte " .. at)
    end
    local item = show(context, tree, at == pointer and f.current or f.to_come, instruction)
    texts[#texts + 1] = instruction.text
    context.info = table.concat(texts, " › ")
    if instruction.opcode == 3 then return transport(context, tree, instruction) end
    if instruction.opcode == 0 then return system(context, tree, instruction, item) end
    at = at + instruction.width
    if at > 255 then
      return context:wrong(item, "pointer-outside", "the next instruction begins at byte " .. at .. ", which no pointer can say")
    end
  end
end

local function packet(context, tree)
  local tvb = context.tvb
  if tvb:len() <= ROUTE_OFFSET then
    context:payload(tree, 0)
    return context:wrong(tree, "short", tvb:len() .. " bytes; a header with one instruction has at least 6")
  end
  local pointer = tvb(0, 1):uint()
  local pointer_item = tree:add(f.pointer, tvb(0, 1))
  local ttl_item = tree:add_le(f.ttl, tvb(1, 2))
  local mtu_item = tree:add_le(f.mtu, tvb(3, 2))
  if pointer < ROUTE_OFFSET or pointer >= tvb:len() then
    context:payload(tree, ROUTE_OFFSET)
    return context:wrong(pointer_item, "pointer-outside", "the pointer is " .. pointer .. ", the packet has " .. tvb:len() .. " bytes")
  end
  if tvb:len() > tvb(3, 2):le_uint() then
    context:wrong(mtu_item, "over-mtu", "the packet is longer than its MTU field")
  end
  if tvb(1, 2):le_uint() == 0 then
    context:wrong(ttl_item, "expired", "the time to live is used up")
  end
  local current = decode(tvb, pointer)
  local is_whole = current and (current.opcode ~= 3 or context:left(pointer) > 3)
  if is_whole and not forwards(current) then
    context:wrong(pointer_item, "not-forwarding", "the pointer is on no step, which is never so on a link")
  end
  taken(context, tree, pointer)
  route(context, tree, pointer)
end

function osap.dissector(tvb, pinfo, tree)
  local context = setmetatable({ tvb = tvb, info = "", causes = {} }, Context)
  pinfo.cols.protocol = "OSAP"
  local root = tree:add(osap, tvb())
  local marked = flags()
  if marked and marked.value >= LINK_ERRORS then
    context:payload(root, 0)
    context:wrong(root, "bad-frame", "the link could not read it; the comment on the frame names the drop")
  else
    packet(context, root)
  end
  if #context.causes > 0 then
    context.info = string.format("[%s] %s", table.concat(context.causes, ", "), context.info)
  end
  pinfo.cols.info = context.info
  return tvb:len()
end

DissectorTable.get("wtap_encap"):add(wtap.USER0, osap)

local udp, bound = DissectorTable.get("udp.port"), 0
function osap.prefs_changed()
  if bound ~= osap.prefs.udp_port then
    if bound ~= 0 then udp:remove(bound, osap) end
    bound = osap.prefs.udp_port
    if bound ~= 0 then udp:add(bound, osap) end
  end
end
