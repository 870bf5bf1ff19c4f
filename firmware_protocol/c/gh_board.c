#include "gh_board.h"

#include <string.h>

#define SAMPLE_MAX_AGE_MS 3000u

typedef struct {
    uint8_t kind;
    uint8_t seq;
    const uint8_t *body;
    size_t length;
} request;

/* Smallest and largest number that the signal's field may carry. */
static const int32_t SIGNAL_RANGE[GH_SIGNAL_COUNT][2] = {
    [GH_SIGNAL_TEMP_AIR] = {GH_SENSOR_REPORT_TEMP_AIR_C_MIN, GH_SENSOR_REPORT_TEMP_AIR_C_MAX},
    [GH_SIGNAL_REL_HUMIDITY] = {0, GH_SENSOR_REPORT_REL_HUMIDITY_PCT_MAX},
    [GH_SIGNAL_CO2] = {0, GH_SENSOR_REPORT_CO2_PPM_MAX},
    [GH_SIGNAL_LIGHT] = {0, GH_SENSOR_REPORT_LIGHT_MAX},
    [GH_SIGNAL_SOIL_MOISTURE] = {0, GH_SENSOR_REPORT_SOIL_MOISTURE_MAX},
    [GH_SIGNAL_TANK_LEVEL] = {0, GH_SENSOR_REPORT_TANK_LEVEL_MAX},
    [GH_SIGNAL_TEMP_AMBIENT] = {GH_SENSOR_REPORT_TEMP_AMBIENT_C_MIN, GH_SENSOR_REPORT_TEMP_AMBIENT_C_MAX},
    [GH_SIGNAL_FAN_RPM] = {0, 65534},
};

/* ---- sending */

static void send(gh_board *board, uint8_t kind, uint8_t ack, const uint8_t *body, size_t length)
{
    uint8_t payload[GH_MAX_PAYLOAD] = {GH_PROTOCOL_VERSION, kind, 0, ack};
    uint8_t frame[GH_MAX_FRAME];
    board->seq = board->seq < 255 ? (uint8_t)(board->seq + 1) : 1;
    payload[2] = board->seq;
    memcpy(payload + GH_HEADER_LENGTH, body, length);
    size_t written = gh_frame_encode(payload, GH_HEADER_LENGTH + length, frame);
    if (written <= GH_TRANSMIT_SIZE - board->waiting) {
        memcpy(board->transmit + board->waiting, frame, written);
        board->waiting = (uint16_t)(board->waiting + written);
    }
}

static void send_hello(gh_board *board, uint8_t ack, uint32_t session)
{
    const gh_board_config *config = &board->config;
    const gh_hello hello = {
        .session = session,
        .protocol_min = GH_PROTOCOL_VERSION,
        .protocol_max = GH_PROTOCOL_VERSION,
        .firmware_major = config->firmware_major,
        .firmware_minor = config->firmware_minor,
        .firmware_patch = config->firmware_patch,
        .board_id = config->board_id,
        .reset_cause = board->reset_cause,
        .boot_count = board->boot_count,
        .capabilities = config->capabilities,
        .lease_max_s = config->lease_max_ms,
        .temp_trip_c = config->temp_trip,
        .valve_pulse_max_s = config->valve_pulse_max_ds,
        .pwm_window_s = config->pwm_window_ds,
        .report_period_s = config->report_period_ms,
        .fan_safe_on = config->fan_safe_on,
    };
    uint8_t body[GH_HELLO_LENGTH];
    send(board, GH_KIND_HELLO, ack, body, gh_pack_hello(&hello, body));
    board->echo_due = true;
}

static uint16_t u16_or_none(const gh_sample *sample)
{
    return sample->raw == GH_NO_VALUE ? UINT16_MAX : (uint16_t)sample->raw;
}

static int16_t i16_or_none(const gh_sample *sample)
{
    return sample->raw == GH_NO_VALUE ? INT16_MIN : (int16_t)sample->raw;
}

static void send_report(gh_board *board, uint32_t now_ms)
{
    const gh_sample *samples = board->samples;
    const gh_sensor_report report = {
        .board_ms = now_ms,
        .temp_air_c = i16_or_none(&samples[GH_SIGNAL_TEMP_AIR]),
        .temp_air_quality = samples[GH_SIGNAL_TEMP_AIR].quality,
        .rel_humidity_pct = u16_or_none(&samples[GH_SIGNAL_REL_HUMIDITY]),
        .rel_humidity_quality = samples[GH_SIGNAL_REL_HUMIDITY].quality,
        .co2_ppm = u16_or_none(&samples[GH_SIGNAL_CO2]),
        .co2_quality = samples[GH_SIGNAL_CO2].quality,
        .light = u16_or_none(&samples[GH_SIGNAL_LIGHT]),
        .light_quality = samples[GH_SIGNAL_LIGHT].quality,
        .soil_moisture = u16_or_none(&samples[GH_SIGNAL_SOIL_MOISTURE]),
        .soil_moisture_quality = samples[GH_SIGNAL_SOIL_MOISTURE].quality,
        .tank_level = u16_or_none(&samples[GH_SIGNAL_TANK_LEVEL]),
        .tank_level_quality = samples[GH_SIGNAL_TANK_LEVEL].quality,
        .temp_ambient_c = i16_or_none(&samples[GH_SIGNAL_TEMP_AMBIENT]),
        .temp_ambient_quality = samples[GH_SIGNAL_TEMP_AMBIENT].quality,
    };
    uint8_t body[GH_SENSOR_REPORT_LENGTH];
    send(board, GH_KIND_SENSOR_REPORT, 0, body, gh_pack_sensor_report(&report, body));
}

static void send_air_pair(gh_board *board)
{
    uint8_t body[GH_AIR_PAIR_LENGTH];
    send(board, GH_KIND_AIR_PAIR, 0, body, gh_pack_air_pair(&board->air_pair, body));
}

/* Writes the body of a state echo and remembers what it told. */
static void echo_state(gh_board *board, uint32_t now_ms, uint8_t *body)
{
    const gh_safety *safety = &board->safety;
    const gh_sample *fan = &board->samples[GH_SIGNAL_FAN_RPM];
    const gh_pins pins = gh_safety_pins(safety);
    const gh_state_echo echo = {
        .board_ms = now_ms,
        .heater_steps = gh_safety_heater_steps(safety),
        .heater_off_cause = gh_safety_heater_off_cause(safety),
        .fan_on = pins.fan,
        .led_pct = pins.led_pct,
        .valve_open = pins.valve,
        .cutoff_open = pins.cutoff_open,
        .tripped = safety->latches != 0,
        .trip_cause = gh_safety_trip_cause(safety),
        .lease_left_s = gh_safety_lease_left_ms(safety, now_ms),
        .fan_rpm = fan->quality == GH_QUALITY_GOOD ? u16_or_none(fan) : UINT16_MAX,
    };
    gh_pack_state_echo(&echo, body);
    board->echoed_off_cause = echo.heater_off_cause;
    board->echoed_trip_cause = echo.trip_cause;
    board->echo_due = false;
}

/* ---- answering */

/* Answers a request and keeps the answer for its repetition. */
static void answer(gh_board *board, uint8_t seq, uint8_t kind, const uint8_t *body, size_t length)
{
    if (board->safety.greeted) {
        board->answer.request_seq = seq;
        board->answer.kind = kind;
        board->answer.length = (uint8_t)length;
        memcpy(board->answer.body, body, length);
    }
    send(board, kind, seq, body, length);
}

static void answer_error(gh_board *board, uint8_t seq, uint8_t code, uint8_t detail)
{
    const uint8_t body[GH_ERROR_LENGTH] = {code, detail};
    answer(board, seq, GH_KIND_ERROR, body, sizeof body);
}

static void answer_state(gh_board *board, uint8_t seq, uint32_t now_ms)
{
    uint8_t body[GH_STATE_ECHO_LENGTH];
    echo_state(board, now_ms, body);
    answer(board, seq, GH_KIND_STATE_ECHO, body, sizeof body);
}

/* True when the command asks for an actuator that the board has not; *field is its number. */
static bool names_missing_actuator(const gh_command *command, uint16_t capabilities, uint8_t *field)
{
    const struct {
        uint8_t wanted, field;
        uint16_t capability;
    } optional[] = {
        {command->led_pct, GH_COMMAND_LED_PCT_FIELD, GH_CAPABILITY_LED},
        {command->valve_pulse_s, GH_COMMAND_VALVE_PULSE_S_FIELD, GH_CAPABILITY_VALVE},
        {command->cutoff_open, GH_COMMAND_CUTOFF_OPEN_FIELD, GH_CAPABILITY_HEATER_CUTOFF},
    };
    for (size_t i = 0; i < sizeof optional / sizeof optional[0]; i++) {
        if (optional[i].wanted != 0 && (capabilities & optional[i].capability) == 0) {
            *field = optional[i].field;
            return true;
        }
    }
    return false;
}

static void serve_command(gh_board *board, uint8_t seq, const gh_command *command, uint32_t now_ms)
{
    const gh_demand demand = {
        .heater_steps = command->heater_steps,
        .led_pct = command->led_pct,
        .fan_on = command->fan_on != 0,
        .fan_on_ms = (uint16_t)(command->fan_on < 2u ? 0u : command->fan_on * 250u),
        .cutoff_open = command->cutoff_open != 0,
        .valve_pulse_ms = (uint16_t)(command->valve_pulse_s * 100u),
        .lease_ms = command->lease_s,
    };
    uint8_t field;
    if (names_missing_actuator(command, board->config.capabilities, &field)) {
        answer_error(board, seq, GH_ERROR_CODE_NO_ACTUATOR, field);
    } else if (!gh_safety_obey(&board->safety, &demand, now_ms)) {
        answer_error(board, seq, GH_ERROR_CODE_TRIPPED, gh_safety_trip_cause(&board->safety));
    } else {
        answer_state(board, seq, now_ms);
    }
}

static void serve_clear_trip(gh_board *board, uint8_t seq, uint32_t now_ms)
{
    if (gh_safety_clear_trip(&board->safety)) {
        answer_state(board, seq, now_ms);
    } else {
        answer_error(board, seq, GH_ERROR_CODE_TRIPPED, gh_safety_trip_cause(&board->safety));
    }
}

static bool is_setup(uint8_t kind)
{
    return kind == GH_KIND_BLOCK_READ || kind == GH_KIND_BLOCK_WRITE || kind == GH_KIND_BLOCK_COMMIT ||
           kind == GH_KIND_WIRE_SEARCH;
}

/* Neither is a new configuration taken while the heater is driven: its pin may be another one there. */
static void serve_setup(gh_board *board, const request *request, uint32_t now_ms)
{
    const gh_setup *setup = board->setup;
    uint8_t heating = gh_safety_heater_steps(&board->safety);
    uint8_t body[GH_BLOCK_PART_LENGTH];
    memcpy(body, request->body, request->length);
    if (request->kind != GH_KIND_BLOCK_READ && heating > 0) {
        answer_error(board, request->seq, GH_ERROR_CODE_HEATING, heating);
    } else if (request->kind == GH_KIND_WIRE_SEARCH) {
        gh_put_u64(body, setup->find(setup->context, body[0] != 0));
        answer(board, request->seq, GH_KIND_WIRE_PART, body, GH_WIRE_PART_LENGTH);
    } else if (request->kind != GH_KIND_BLOCK_COMMIT) {
        (request->kind == GH_KIND_BLOCK_READ ? setup->read : setup->write)(setup->context, body[0], body + 1);
        answer(board, request->seq, GH_KIND_BLOCK_PART, body, sizeof body);
    } else if (!setup->commit(setup->context)) {
        answer_error(board, request->seq, GH_ERROR_CODE_BAD_BLOCK, 0);
    } else {
        board->restart = true;
        answer_state(board, request->seq, now_ms);
    }
}

/* 0, or the error that answers the request: GH_DECODE_ERROR. */
static int decode_setup(const request *request)
{
    gh_block_read read;
    gh_block_write write;
    gh_wire_search search;
    switch (request->kind) {
    case GH_KIND_BLOCK_READ:
        return gh_unpack_block_read(request->body, request->length, &read);
    case GH_KIND_BLOCK_WRITE:
        return gh_unpack_block_write(request->body, request->length, &write);
    case GH_KIND_WIRE_SEARCH:
        return gh_unpack_wire_search(request->body, request->length, &search);
    default:
        return request->length == 0 ? 0 : GH_DECODE_ERROR(GH_ERROR_CODE_LENGTH, request->length);
    }
}

static int decode(const gh_board *board, const request *request, gh_command *command)
{
    bool configurable = board->setup != NULL && (board->config.capabilities & GH_CAPABILITY_CONFIGURABLE) != 0;
    if (is_setup(request->kind) && configurable) {
        return decode_setup(request);
    }
    switch (request->kind) {
    case GH_KIND_COMMAND:
        return gh_unpack_command(request->body, request->length, command);
    case GH_KIND_HELLO_REQUEST: /* one of the right length does not come here */
        return GH_DECODE_ERROR(GH_ERROR_CODE_LENGTH, request->length);
    case GH_KIND_CLEAR_TRIP:
    case GH_KIND_PING:
    case GH_KIND_EMERGENCY_STOP:
    case GH_KIND_MAINTENANCE:
    case GH_KIND_RELEASE_STOP:
    case GH_KIND_END_MAINTENANCE:
        return request->length == 0 ? 0 : GH_DECODE_ERROR(GH_ERROR_CODE_LENGTH, request->length);
    default:
        return GH_DECODE_ERROR(GH_ERROR_CODE_UNKNOWN_KIND, request->kind);
    }
}

static void serve(gh_board *board, const request *request, uint32_t now_ms)
{
    gh_command command = {0};
    int refused = decode(board, request, &command);
    if (refused != 0) {
        answer_error(board, request->seq, GH_DECODE_CODE(refused), GH_DECODE_DETAIL(refused));
        return;
    }
    if (!board->safety.greeted) {
        answer_error(board, request->seq, GH_ERROR_CODE_NOT_GREETED, request->kind);
        return;
    }
    if (is_setup(request->kind)) {
        serve_setup(board, request, now_ms);
        return;
    }
    switch (request->kind) {
    case GH_KIND_COMMAND:
        serve_command(board, request->seq, &command, now_ms);
        return;
    case GH_KIND_CLEAR_TRIP:
        serve_clear_trip(board, request->seq, now_ms);
        return;
    case GH_KIND_EMERGENCY_STOP:
        gh_safety_trip(&board->safety, GH_TRIP_CAUSE_EMERGENCY_STOP);
        break;
    case GH_KIND_MAINTENANCE:
        gh_safety_trip(&board->safety, GH_TRIP_CAUSE_MAINTENANCE);
        break;
    case GH_KIND_RELEASE_STOP:
        gh_safety_release(&board->safety, GH_TRIP_CAUSE_EMERGENCY_STOP);
        break;
    case GH_KIND_END_MAINTENANCE:
        gh_safety_release(&board->safety, GH_TRIP_CAUSE_MAINTENANCE);
        break;
    default: /* ping */
        break;
    }
    answer_state(board, request->seq, now_ms);
}

static void greet(gh_board *board, const request *request)
{
    board->answer.request_seq = 0;
    gh_safety_greet(&board->safety);
    send_hello(board, request->seq, gh_get_u32(request->body));
}

static bool sent_by_boards(uint8_t kind)
{
    return kind == GH_KIND_HELLO || kind == GH_KIND_SENSOR_REPORT || kind == GH_KIND_STATE_ECHO ||
           kind == GH_KIND_ERROR || kind == GH_KIND_BLOCK_PART || kind == GH_KIND_WIRE_PART ||
           kind == GH_KIND_AIR_PAIR;
}

static void take_payload(gh_board *board, const uint8_t *payload, size_t length, uint32_t now_ms)
{
    const request request = {payload[1], payload[2], payload + GH_HEADER_LENGTH, length - GH_HEADER_LENGTH};
    if (payload[0] != GH_PROTOCOL_VERSION) {
        const uint8_t error[GH_ERROR_LENGTH] = {GH_ERROR_CODE_VERSION, GH_PROTOCOL_VERSION};
        send(board, GH_KIND_ERROR, request.seq, error, sizeof error);
    } else if (sent_by_boards(request.kind) || request.seq == 0) {
        board->not_for_us++;
    } else if (request.kind == GH_KIND_HELLO_REQUEST && request.length == GH_HELLO_REQUEST_LENGTH) {
        greet(board, &request);
    } else if (request.seq == board->answer.request_seq) {
        send(board, board->answer.kind, request.seq, board->answer.body, board->answer.length);
    } else {
        serve(board, &request, now_ms);
    }
}

/* ---- entries */

size_t gh_board_size(void)
{
    return sizeof(gh_board);
}

static void advance(gh_board *board, uint32_t now_ms)
{
    for (size_t i = 0; i < GH_SIGNAL_COUNT; i++) {
        gh_sample *sample = &board->samples[i];
        if (sample->quality == GH_QUALITY_GOOD && now_ms - sample->time_ms > SAMPLE_MAX_AGE_MS) {
            sample->quality = GH_QUALITY_STALE; /* kept, so that a clock that wraps cannot make it fresh again */
        }
    }
    gh_safety_advance(&board->safety, now_ms);
}

static uint16_t within(uint16_t value, uint16_t low, uint16_t high)
{
    return value < low ? low : value > high ? high : value;
}

/* What hello could not tell would divide by zero or overflow. */
static void limit_config(gh_board_config *config)
{
    config->lease_max_ms = within(config->lease_max_ms, GH_HELLO_LEASE_MAX_S_MIN, GH_HELLO_LEASE_MAX_S_MAX);
    config->valve_pulse_max_ds = within(config->valve_pulse_max_ds, 0, GH_HELLO_VALVE_PULSE_MAX_S_MAX);
    config->pwm_window_ds = within(config->pwm_window_ds, GH_HELLO_PWM_WINDOW_S_MIN, GH_HELLO_PWM_WINDOW_S_MAX);
    config->report_period_ms =
        within(config->report_period_ms, GH_HELLO_REPORT_PERIOD_S_MIN, GH_HELLO_REPORT_PERIOD_S_MAX);
    uint16_t trip = config->temp_trip < 0 ? 0 : (uint16_t)config->temp_trip;
    config->temp_trip = (int16_t)within(trip, GH_HELLO_TEMP_TRIP_C_MIN, GH_HELLO_TEMP_TRIP_C_MAX);
}

void gh_board_init(gh_board *board, const gh_board_config *wanted, const uint8_t *persistent, uint8_t reset_cause,
                   uint32_t boot_count)
{
    memset(board, 0, sizeof *board);
    gh_board_config *config = &board->config;
    *config = *wanted;
    limit_config(config);
    const gh_safety_config safety = {
        .lease_max_ms = config->lease_max_ms,
        .valve_pulse_max_ms = (uint16_t)(config->valve_pulse_max_ds * 100u),
        .pwm_slot_ms = (uint16_t)(config->pwm_window_ds * (100u / GH_PWM_SLOTS)),
        .temp_trip = config->temp_trip,
        .fan_safe_on = config->fan_safe_on,
        .has_cutoff = (config->capabilities & GH_CAPABILITY_HEATER_CUTOFF) != 0,
    };
    board->reset_cause = reset_cause <= GH_RESET_CAUSE_UNKNOWN ? reset_cause : GH_RESET_CAUSE_UNKNOWN;
    board->boot_count = boot_count;
    for (size_t i = 0; i < GH_SIGNAL_COUNT; i++) {
        board->samples[i].raw = GH_NO_VALUE;
        board->samples[i].quality = GH_QUALITY_ABSENT;
    }
    gh_safety_init(&board->safety, &safety, persistent);
    gh_frame_decoder_init(&board->decoder);
    send_hello(board, 0, 0);
}

void gh_board_use_setup(gh_board *board, const gh_setup *setup)
{
    board->setup = setup;
}

void gh_board_receive(gh_board *board, uint8_t byte, uint32_t now_ms)
{
    advance(board, now_ms);
    size_t length = gh_frame_push(&board->decoder, byte);
    if (length > 0) {
        take_payload(board, board->decoder.bytes, length, now_ms);
    }
}

/* The quality a sample deserves: good only for a number that its field may carry and its sensor may show. */
static uint8_t judge(gh_signal signal, int32_t *raw, uint8_t quality)
{
    uint8_t worst = quality <= GH_QUALITY_ABSENT ? quality : GH_QUALITY_FAULT;
    uint8_t found = GH_QUALITY_GOOD;
    if (*raw == GH_NO_VALUE) {
        found = GH_QUALITY_FAULT;
    } else if (*raw < SIGNAL_RANGE[signal][0] || *raw > SIGNAL_RANGE[signal][1]) {
        *raw = GH_NO_VALUE;
        found = GH_QUALITY_RANGE;
    } else if (signal == GH_SIGNAL_TEMP_AIR && (*raw < GH_AIR_MIN || *raw > GH_AIR_MAX)) {
        found = GH_QUALITY_RANGE;
    }
    return worst == GH_QUALITY_GOOD ? found : worst;
}

void gh_board_sample(gh_board *board, gh_signal signal, int32_t raw, uint8_t quality, uint32_t now_ms)
{
    advance(board, now_ms);
    gh_sample *sample = &board->samples[signal];
    sample->quality = judge(signal, &raw, quality);
    sample->raw = raw;
    sample->time_ms = now_ms;
    if (signal == GH_SIGNAL_TEMP_AIR) {
        gh_safety_sample_air(&board->safety, (int16_t)raw, sample->quality == GH_QUALITY_GOOD, now_ms);
    }
}

static bool echo_is_due(const gh_board *board)
{
    return board->echo_due || board->echoed_trip_cause != gh_safety_trip_cause(&board->safety) ||
           board->echoed_off_cause != gh_safety_heater_off_cause(&board->safety);
}

static bool report_is_due(gh_board *board, uint32_t now_ms)
{
    uint32_t elapsed = now_ms - board->report_ms;
    uint16_t period = board->config.report_period_ms;
    if (elapsed < period) {
        return false; /* most often, without a division */
    }
    board->report_ms += elapsed / period * period;
    return true;
}

static int16_t pair_value(int32_t raw)
{
    return raw < GH_AIR_PAIR_FIRST_C_MIN || raw > GH_AIR_PAIR_FIRST_C_MAX ? (int16_t)INT16_MIN : (int16_t)raw;
}

void gh_board_sample_pair(gh_board *board, int32_t first, int32_t second, uint8_t verdict)
{
    board->has_air_pair = true;
    board->air_pair = (gh_air_pair){pair_value(first), pair_value(second), verdict};
}

gh_pins gh_board_step(gh_board *board, uint32_t now_ms)
{
    advance(board, now_ms);
    if (echo_is_due(board)) {
        uint8_t body[GH_STATE_ECHO_LENGTH];
        echo_state(board, now_ms, body);
        send(board, GH_KIND_STATE_ECHO, 0, body, sizeof body);
    }
    if (report_is_due(board, now_ms)) {
        send_report(board, now_ms);
        if (board->has_air_pair) {
            send_air_pair(board);
        }
    }
    return gh_safety_pins(&board->safety);
}

size_t gh_board_transmit(gh_board *board, uint8_t *out, size_t size)
{
    size_t moved = size < board->waiting ? size : board->waiting;
    memcpy(out, board->transmit, moved);
    board->waiting = (uint16_t)(board->waiting - moved);
    memmove(board->transmit, board->transmit + moved, board->waiting);
    return moved;
}

void gh_board_persistent(const gh_board *board, uint8_t *out)
{
    gh_safety_persistent(&board->safety, out);
}
