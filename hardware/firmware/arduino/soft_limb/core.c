#include "core.h"

#include <string.h>

/* A product and a sum round twice, on every chip and in every dialect of C: Arduino's dialect lets a
compiler fuse them, and then the last bits depend on the chip. */
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif

#define R(number) ((real)(number)) /* or each double would take a single's place */

/* The reasons for these numbers are in guard.py, heat.py and docs/protocol.md. Times are in ms. */
enum { AVERAGING_TIME = 1000, HEARTBEAT = 250, LONGEST_HOLD = 290 };
enum { STILL_BEGIN = 5000, STILL_END = 10000, STILL_LATEST = 15000 };
enum { SETTLING_SAMPLES = 10, HOT_SAMPLES = 4, BAD_SAMPLES = 3, STUCK_SAMPLES = 10 };
enum { THERMOCOUPLE_TURN = 2 }; /* samples: a MAX31855 needs 100 ms between readings to convert */
enum { LONGEST_STANDSTILL = 50 }; /* passes of the loop */

/* Temperatures, °C. */
#define TEMPERATURE_LIMIT R(110)
#define OVERSHOOT R(10)
#define NO_DUTY_TEMPERATURE R(105)
#define TAPER_WIDTH R(5)
#define MAX_WIRE_TEMPERATURE R(127)
#define LAST_TAPER_WIDTH R(10)
#define HIGHEST_RISE R(102)
#define COLDEST_ROOM R(10)
#define WARM_ROOM R(25)
#define COLD_RISE R(3)
#define AGREEMENT_TOLERANCE R(8)
#define PROOF_RISE R(2)
#define PROVEN_MARGIN R(10)
#define MIN_DETECTABLE_RISE R(6)
#define LARGEST_JUMP R(10)
#define MAX_SHORTFALL R(3)
#define MAX_EXCESS R(15)
#define MIN_PULL_CHANGE R(60)
/* The heat of a wire, with rates in 1/s and times in s. */
#define SILICONE_SHARE R(0.35)
#define SILICONE_RATE R(0.02)
#define HEAT_AVERAGING R(1)
#define LONGEST_STEP R(0.1)
#define APPROACH_TIME R(0.5)
#define LITTLE_DUTY R(0.12)
/* Factors, and 1/64 degrees. */
#define LEAD_FACTOR R(2.5)
#define EXCESS_HEAT_FACTOR R(1.5)
#define CROSSTALK R(0.25)
#define MIN_TIP_MOTION R(3 * 64)

static real least_of(real a, real b)
{
    return b < a ? b : a;
}

static real most_of(real a, real b)
{
    return b > a ? b : a;
}

/* Frames: a struct is a payload; version and type come before it, the CRC after it. */

enum { SAMPLE_PERIOD = 50 /* ms */, FULL_DUTY = 10000, NO_READING = -0x8000 };
enum { VERSION = 5, FLAG = 0x7E, ESCAPE = 0x7D, FLIP = 0x20 };
enum { HELLO = 0x01, ARM = 0x02, COMMAND = 0x03, DISARM = 0x04, CLEAR = 0x05, BOUNDS = 0x06 };
enum { INFO = 0x81, SAMPLE = 0x82, CHANNEL_VALUES = 0x83 }; /* to the host; those above are from it */

#pragma pack(push, 1)
struct arm {
    uint16_t challenge;
    uint8_t channels;
    uint16_t total;  /* largest sum of both duties, 1/10000 */
    uint16_t parts;  /* low half of the CRC-32 of both BOUNDS */
};
struct command {
    uint16_t session, sequence;
    uint32_t sample_time;    /* of the newest SAMPLE that the host has, ms */
    uint16_t duty[CHANNELS]; /* 1/10000 */
};
struct clear {
    uint16_t challenge;
};
struct info {
    uint16_t version, sample_period; /* 5, 50 ms */
    int16_t limit;                   /* 1/4 °C */
    uint8_t serial_number[8], channels, angles, reset_cause;
};
struct sample {
    uint16_t sequence;
    uint32_t time; /* ms */
    uint16_t challenge;
    uint8_t state, reason;
    uint16_t acknowledged; /* the last sequence */
    int16_t bend;          /* 1/64 degrees */
};
struct channel_values {
    uint16_t sequence; /* of the SAMPLE */
    uint8_t first, channels;
    struct {
        int16_t temperature; /* 1/4 °C, or NO_READING */
        uint16_t duty;       /* applied, 1/10000 */
        uint8_t warmest;     /* °C */
    } channel[CHANNELS];
};
#pragma pack(pop)
_Static_assert(sizeof(struct part) == 14, "BOUNDS is not packed");
_Static_assert(sizeof(struct info) == 17, "INFO is not packed");
_Static_assert(sizeof(struct channel_values) <= MAX_PAYLOAD, "CHANNELS is not packed");
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "payloads are little endian");

/* The CRC of Ethernet and zlib; its low byte is sent first. */
static uint32_t crc32(const uint8_t *data, int size)
{
    uint32_t crc = 0xFFFFFFFF;
    while (size--) {
        crc ^= *data++;
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320 : 0);
    }
    return ~crc;
}

/* Write a frame to `out`, which has room for MAX_FRAME bytes; return its size. */
static int make_frame(uint8_t *out, uint8_t type, const void *payload, int size)
{
    uint8_t body[MAX_BODY] = {VERSION, type};
    memcpy(body + 2, payload, size);
    uint32_t crc = crc32(body, 2 + size);
    memcpy(body + 2 + size, &crc, 4);
    int count = 0;
    out[count++] = FLAG;
    for (int i = 0; i < 6 + size; i++) {
        if (body[i] == FLAG || body[i] == ESCAPE || body[i] == 0x03) {
            out[count++] = ESCAPE;
            out[count++] = body[i] ^ FLIP;
        } else {
            out[count++] = body[i];
        }
    }
    out[count++] = FLAG;
    return count;
}

static int payload_size(uint8_t type) /* of frames to the board; -1 if there is no such frame */
{
    switch (type) {
    case HELLO:
    case DISARM:
        return 0;
    case ARM:
        return sizeof(struct arm);
    case COMMAND:
        return sizeof(struct command);
    case CLEAR:
        return sizeof(struct clear);
    case BOUNDS:
        return sizeof(struct part);
    default:
        return -1;
    }
}

/* Parse a byte; return the size of the payload if a frame for a board has ended, else -1. */
static int take_byte(struct parser *parser, uint8_t byte)
{
    if (byte == FLAG) {
        int size = parser->size - 6, whole = 0;
        if (!parser->lost && !parser->escaping && size >= 0) {
            uint32_t crc;
            memcpy(&crc, parser->body + parser->size - 4, 4);
            whole = crc == crc32(parser->body, parser->size - 4) && parser->body[0] == VERSION &&
                    size == payload_size(parser->body[1]);
        }
        parser->size = parser->escaping = parser->lost = 0;
        return whole ? size : -1;
    }
    if (parser->lost)
        return -1;
    if (byte == ESCAPE && !parser->escaping) {
        parser->escaping = 1;
        return -1;
    }
    if (byte == ESCAPE || parser->size == MAX_BODY) { /* two escapes, or too long */
        parser->lost = 1;
        parser->size = parser->escaping = 0;
        return -1;
    }
    parser->body[parser->size++] = parser->escaping ? byte ^ FLIP : byte;
    parser->escaping = 0;
    return -1;
}

/* Sensors. */

/* Decode the 32 bits of a MAX31855. */
static struct thermocouple read_max31855(uint32_t word)
{
    const uint32_t reserved = 1UL << 17 | 1UL << 3, fault = 1UL << 16;
    struct thermocouple reading;
    reading.faults = word & 7;
    if (word == 0 || word == 0xFFFFFFFF) /* a bus that answers nothing */
        reading.faults |= 1;
    else if (word & reserved || !(word & fault) != !reading.faults)
        reading.faults |= 8;
    reading.quarters = (int16_t)(word >> 18); /* 14 bits */
    if (reading.quarters >= 0x2000)
        reading.quarters -= 0x4000;
    reading.sixteenths = word >> 4 & 0xFFF;
    if (reading.sixteenths >= 0x800)
        reading.sixteenths -= 0x1000;
    return reading;
}

/* The heat of a wire, by Euler's method. */

static void use_bounds(struct wire *wire, const struct bounds *bounds)
{
    wire->a1_slow = bounds->a1_slow / R(1000);
    wire->a1_fast = bounds->a1_fast / R(1000);
    wire->a2_least = bounds->a2_least / R(100);
    wire->a2_most = bounds->a2_most / R(100);
    wire->a3_slow = bounds->a3_slow / R(1000);
}

static void begin_wire(struct wire *wire, real most)
{
    static const struct bounds nominal = {42, 95, 1700, 2300, 500};
    memset(wire, 0, sizeof *wire);
    use_bounds(wire, &nominal);
    wire->most = most;
    wire->silicone = SILICONE_SHARE * most;
}

/* Return whether bounds are in their ranges and in order. */
static int bounds_acceptable(const struct bounds *b)
{
    return 5 <= b->a1_slow && b->a1_slow <= 200 && 10 <= b->a1_fast && b->a1_fast <= 500 &&
           400 <= b->a2_least && b->a2_least <= 6000 && 800 <= b->a2_most &&
           b->a2_most <= 10000 && 100 <= b->a3_slow && b->a3_slow <= 4000 &&
           b->a1_slow <= b->a1_fast && b->a2_least <= b->a2_most;
}

/* Return whether readings show too much heat of a wire with wrong bounds. */
static int can_detect_overheating(const struct bounds *bounds, uint16_t total)
{
    struct wire w;
    use_bounds(&w, bounds);
    real lasting = HIGHEST_RISE * w.a1_slow * (1 - SILICONE_SHARE) / w.a2_most;
    return total / R(FULL_DUTY) <= LITTLE_DUTY || lasting <= LITTLE_DUTY ||
           w.a2_least / w.a1_fast * LITTLE_DUTY >= MIN_DETECTABLE_RISE;
}

/* Update the bounds of a wire's temperature. duty: mean since the last call; seconds: since then;
reading: °C above the room. */
static void give_heat(struct wire *wire, real duty, real seconds, real reading)
{
    int steps = (int)(seconds / LONGEST_STEP) + 1;
    real dt = seconds / steps;
    for (int step = 0; step < steps; step++) {
        real least = wire->least, most = wire->most, silicone = wire->silicone;
        wire->least_reading += dt * wire->a3_slow * (least - wire->least_reading);
        wire->least += dt * (wire->a2_least * duty - wire->a1_fast * least);
        real rate = wire->a2_most * duty - wire->a1_slow * (most - silicone);
        wire->most += dt * rate;
        wire->hidden = most_of(0, wire->hidden + dt * (rate - wire->a3_slow * wire->hidden));
        wire->silicone += dt * SILICONE_RATE * (SILICONE_SHARE * most - silicone);
        real below = wire->least_reading - reading;
        wire->shortfall += dt / HEAT_AVERAGING * (below - wire->shortfall);
    }
}

/* Return the duty, in [0, 1], at which the wire cannot get above `highest`. */
static real allowed_duty(const struct wire *wire, real highest)
{
    real loss = wire->a1_slow * (wire->most - wire->silicone);
    real duty = (loss + (highest - wire->most) / APPROACH_TIME) / wire->a2_most;
    return least_of(1, most_of(0, duty));
}

/* The guard: whether wires may be heated, and how much. All safety rules are here. */

enum { DISARMED, ARMED }; /* states */
/* Reasons for which the board is off; those from LATCHING on stay until they are cleared. */
enum { NO_REASON, NO_COMMAND, OUT_OF_RANGE, BY_HOST, POWER_UP, WAS_RESET, LATE_COMMANDS };
enum { BAD_BOUNDS = 7, DISAGREEING, LATCHING = 16 };
enum { OVER_TEMPERATURE = LATCHING, THERMOCOUPLE_OPEN, THERMOCOUPLE_TO_GROUND };
enum { THERMOCOUPLE_TO_SUPPLY = 19, TEMPERATURE_JUMP, NOT_WARMING, BEND_SILENT, BEND_STUCK };
enum { TOO_WARM = 24, BELOW_ROOM, AMPLIFIER_FAULT, RESTARTED, CLOCK_STANDS };

/* Count the heat that the wires got up to now. */
static void account(struct guard *g, uint32_t now)
{
    for (int i = 0; i < CHANNELS; i++)
        g->channel[i].heat_given += g->channel[i].duty * (now - g->heat_counted_until);
    g->heat_counted_until = now;
}

/* Set the duty to the commanded duty, as far as temperatures and total duty allow it. */
static void apply_duty(struct guard *g, uint32_t now)
{
    account(g, now);
    real sum = 0;
    for (int i = 0; i < CHANNELS; i++) {
        struct channel *c = &g->channel[i];
        c->duty = least_of(c->commanded, c->allowed);
        sum += c->duty;
    }
    if (sum > g->total)
        for (int i = 0; i < CHANNELS; i++)
            g->channel[i].duty *= g->total / sum;
}

/* Set a new challenge: older frames can neither arm nor command. */
static void renew(struct guard *g)
{
    g->challenge = (uint16_t)(g->challenge * 25173UL + 13849);
}

/* Switch off. The first latching reason is kept; newer reasons replace other reasons. */
static void trip(struct guard *g, uint8_t reason, uint32_t now)
{
    for (int i = 0; i < CHANNELS; i++)
        g->channel[i].commanded = 0;
    apply_duty(g, now);
    if (reason >= LATCHING)
        g->faulty = 1;
    if (g->reason < LATCHING)
        g->reason = reason;
    if (g->state == ARMED) {
        g->state = DISARMED;
        renew(g);
    }
}

static void begin_guard(struct guard *g, uint32_t now, uint16_t challenge, uint8_t reason)
{
    memset(g, 0, sizeof *g);
    g->challenge = challenge;
    g->reason = reason;
    g->heat_counted_until = g->sample_time = now;
    for (int i = 0; i < CHANNELS; i++) /* nobody knows how warm wires are after a reset */
        begin_wire(&g->channel[i].wire, reason == POWER_UP ? 0 : HIGHEST_RISE);
}

/* Return the least pull to the right: °C of right wires minus °C of left wires. */
static real pull_of(const struct guard *g)
{
    real pull = 0;
    for (int i = 0; i < CHANNELS; i++)
        pull += g->channel[i].side * g->channel[i].wire.least;
    return pull;
}

/* Return whether cold wires and both amplifiers have the same temperature, of a room. */
static int sensors_agree(const struct guard *g)
{
    real low = g->channel[0].junction, high = low, coldest = low;
    for (int i = 0; i < CHANNELS; i++) {
        const struct channel *c = &g->channel[i];
        coldest = least_of(coldest, c->junction);
        low = least_of(low, c->junction);
        high = most_of(high, c->junction);
        if (c->wire.most < COLD_RISE) {
            low = least_of(low, c->average);
            high = most_of(high, c->average);
        }
    }
    return high - low <= AGREEMENT_TOLERANCE && coldest >= COLDEST_ROOM;
}

enum { TO_THE_RIGHT = 0, TO_THE_LEFT = 16 }; /* pulls of wires */

/* Return whether all BOUNDS came that an ARM is for, each for a wire that bends to a side. */
static int is_whole(const struct guard *g, const struct arm *arm)
{
    int whole = arm->channels == CHANNELS;
    for (int i = 0; i < CHANNELS; i++)
        whole = whole && g->part[i].received && g->part[i].part.challenge == arm->challenge &&
                (g->part[i].part.pull == TO_THE_LEFT || g->part[i].part.pull == TO_THE_RIGHT);
    uint8_t parts[CHANNELS * sizeof(struct part)];
    for (int i = 0; i < CHANNELS; i++)
        memcpy(parts + i * sizeof(struct part), &g->part[i].part, sizeof(struct part));
    return whole && arm->parts == (uint16_t)crc32(parts, sizeof parts);
}

static void take_arm(struct guard *g, const struct arm *arm, uint32_t now)
{
    if (arm->challenge != g->challenge || g->state == ARMED || g->reason >= LATCHING)
        return;
    if (g->samples < SETTLING_SAMPLES || g->faulty)
        return;
    int good = is_whole(g, arm) && 0 < arm->total && arm->total <= CHANNELS * FULL_DUTY;
    for (int i = 0; i < CHANNELS; i++) {
        const struct bounds *bounds = &g->part[i].part.bounds;
        good = good && bounds_acceptable(bounds) && can_detect_overheating(bounds, arm->total);
    }
    if (!good) {
        g->reason = BAD_BOUNDS;
        return;
    }
    if (!sensors_agree(g)) {
        g->reason = DISAGREEING;
        return;
    }
    g->state = ARMED;
    g->reason = NO_REASON;
    g->session = arm->challenge;
    g->acknowledged = 0;
    g->command_time = g->answered_time = now;
    g->late = 0;
    g->total = arm->total / R(FULL_DUTY);
    int turned = 0;
    for (int i = 0; i < CHANNELS; i++) {
        int side = g->part[i].part.pull == TO_THE_RIGHT ? 1 : -1;
        turned = turned || side != g->channel[i].side;
        g->channel[i].side = side;
    }
    if (turned)
        g->pull_low = g->pull_high = pull_of(g);
    for (int i = 0; i < CHANNELS; i++)
        use_bounds(&g->channel[i].wire, &g->part[i].part.bounds);
}

static void take_command(struct guard *g, const struct command *c, uint32_t now)
{
    uint16_t ahead = c->sequence - g->acknowledged;
    if (g->state != ARMED || c->session != g->session || ahead == 0 || ahead >= 0x8000)
        return;
    if (c->duty[0] > FULL_DUTY || c->duty[1] > FULL_DUTY) {
        trip(g, OUT_OF_RANGE, now);
        return;
    }
    uint32_t age = now - c->sample_time; /* one from the future is very old */
    if (age >= HEARTBEAT) {
        g->late = 1;
        return;
    }
    g->acknowledged = c->sequence;
    g->command_time = now;
    if ((int32_t)(c->sample_time - g->answered_time) > 0)
        g->answered_time = c->sample_time;
    g->late = 0;
    for (int i = 0; i < CHANNELS; i++)
        g->channel[i].commanded = c->duty[i] / R(FULL_DUTY);
    apply_duty(g, now);
}

static void take_clear(struct guard *g, const struct clear *clear)
{
    if (clear->challenge == g->challenge && g->reason >= LATCHING) {
        g->reason = BY_HOST;
        renew(g);
    }
}

/* End a duty that has held for as long as it may; called in every pass. */
static void check_time(struct guard *g, uint32_t now)
{
    if (g->state == ARMED &&
        (now - g->command_time >= HEARTBEAT || now - g->answered_time >= LONGEST_HOLD))
        trip(g, g->late ? LATE_COMMANDS : NO_COMMAND, now);
}

/* Average over noise, and estimate the reading of each thermocouple in the room. */
static void average(struct guard *g, const real *temperatures, const real *junctions, real share)
{
    for (int i = 0; i < CHANNELS; i++) {
        struct channel *c = &g->channel[i];
        if (!g->samples) {
            c->average = c->trend = temperatures[i];
            c->junction = junctions[i];
        }
        c->average += share * (temperatures[i] - c->average);
        c->trend += share * (c->average - c->trend);
        c->junction += share * (junctions[i] - c->junction);
    }
    real amplifiers = (g->channel[0].junction + g->channel[1].junction) / 2;
    for (int i = 0; i < CHANNELS; i++) {
        struct channel *c = &g->channel[i];
        real offset = c->average - amplifiers;
        if (offset < -AGREEMENT_TOLERANCE)
            trip(g, BELOW_ROOM, g->heat_counted_until);
        offset = least_of(AGREEMENT_TOLERANCE, most_of(-AGREEMENT_TOLERANCE, offset));
        /* No wire is below the room, so a cold wire has the least difference. */
        if (g->samples > SETTLING_SAMPLES)
            offset = least_of(offset, c->offset);
        c->offset = offset;
        c->room = amplifiers + offset;
    }
}

/* Mark a thermocouple as proven if it follows heat: it shows about the wire's rise. */
static void prove(struct channel *c)
{
    if (c->wire.least < PROOF_RISE / 4 || c->average < c->unheated)
        c->unheated = c->average;
    if (c->wire.least > PROOF_RISE / 2 && c->average - c->unheated > PROOF_RISE) {
        c->proven = 1; /* the silicone may be warm from before */
        c->wire.most = least_of(2 * (c->average - c->room) + PROVEN_MARGIN, HIGHEST_RISE);
        c->wire.silicone = least_of(c->wire.most, SILICONE_SHARE * HIGHEST_RISE);
    }
}

/* Return the allowed duty of a wire, less and less while its reading stands still. */
static real duty_of_still_reading(struct guard *g, struct channel *c, real temperature, uint32_t now)
{
    if (!g->samples || temperature != c->still || c->wire.least < MAX_SHORTFALL) {
        c->still = temperature;
        c->moved = now;
    }
    uint32_t still = now - c->moved;
    if (still > STILL_LATEST && temperature - c->room > AGREEMENT_TOLERANCE)
        trip(g, NOT_WARMING, now);
    return ((real)STILL_END - still) / (STILL_END - STILL_BEGIN);
}

static uint8_t reason_of(uint8_t faults)
{
    if (faults & 1)
        return THERMOCOUPLE_OPEN;
    if (faults & 2)
        return THERMOCOUPLE_TO_GROUND;
    return faults & 4 ? THERMOCOUPLE_TO_SUPPLY : AMPLIFIER_FAULT;
}

static void check_wire(struct guard *g, int i, real temperature, uint8_t faults, uint32_t elapsed,
                       uint32_t now)
{
    struct channel *c = &g->channel[i];
    if (!faults)
        c->bad = 0;
    else if (c->bad < BAD_SAMPLES)
        c->bad++;
    if (c->bad >= BAD_SAMPLES)
        trip(g, reason_of(faults), now);
    if (!g->begun)
        return;
    if (!faults && temperature <= TEMPERATURE_LIMIT)
        c->hot = 0;
    else if (!faults && c->hot < HOT_SAMPLES)
        c->hot++;
    if (c->hot >= HOT_SAMPLES)
        trip(g, OVER_TEMPERATURE, now);
    real jump = temperature - c->temperature;
    if (g->samples && (jump > LARGEST_JUMP || jump < -LARGEST_JUMP))
        trip(g, TEMPERATURE_JUMP, now);
    if (g->samples <= SETTLING_SAMPLES)
        c->wire.most = most_of(c->wire.most, c->average - c->room);
    if (elapsed > 0)
        give_heat(&c->wire, c->heat_given / elapsed, elapsed / R(1000), temperature - c->room);
    if (!c->proven)
        prove(c);
    if (c->wire.shortfall > MAX_SHORTFALL)
        trip(g, NOT_WARMING, now);
    /* Estimate the wire, which is ahead of its thermocouple. */
    real ahead = c->average + LEAD_FACTOR * most_of(0, c->average - c->trend);
    if (ahead > TEMPERATURE_LIMIT + OVERSHOOT)
        trip(g, OVER_TEMPERATURE, now);
    if (ahead - c->room > c->wire.most + MAX_EXCESS + CROSSTALK * g->channel[1 - i].wire.most)
        trip(g, TOO_WARM, now);
    /* A supply may give more heat than the bound of the most heat, and a thermocouple that lags
    shows that late. */
    real with_excess = temperature + EXCESS_HEAT_FACTOR * c->wire.hidden;
    real tapered = least_of((NO_DUTY_TEMPERATURE - ahead) / TAPER_WIDTH,
                            (MAX_WIRE_TEMPERATURE - with_excess) / LAST_TAPER_WIDTH);
    real amplifiers = (g->channel[0].junction + g->channel[1].junction) / 2;
    real room = most_of(most_of(c->room, amplifiers), WARM_ROOM); /* if in doubt, it is warm */
    real allowed = c->proven ? allowed_duty(&c->wire, MAX_WIRE_TEMPERATURE - room) : LITTLE_DUTY;
    allowed = least_of(least_of(allowed, tapered), duty_of_still_reading(g, c, temperature, now));
    c->allowed = faults ? 0 : most_of(0, allowed);
}

static void check_bend(struct guard *g, int answers, int16_t bend, real share, uint32_t now)
{
    if (!answers) {
        trip(g, BEND_SILENT, now);
        return;
    }
    if (!g->has_bend)
        g->tip = bend;
    if (!g->has_bend || bend != g->bend)
        g->equal_bends = 0;
    else if (g->equal_bends < STUCK_SAMPLES)
        g->equal_bends++;
    if (g->equal_bends >= STUCK_SAMPLES)
        trip(g, BEND_STUCK, now);
    g->has_bend = 1;
    g->bend = bend;
    g->tip += share * (bend - g->tip);
    real pull = pull_of(g);
    real turned = g->tip - g->tip_before;
    if (turned > MIN_TIP_MOTION || turned < -MIN_TIP_MOTION) {
        g->tip_before = g->tip;
        g->pull_low = g->pull_high = pull;
    }
    g->pull_low = least_of(g->pull_low, pull);
    g->pull_high = most_of(g->pull_high, pull);
    if (g->pull_high - g->pull_low > MIN_PULL_CHANGE)
        trip(g, BEND_STUCK, now);
}

/* Check a sample of all sensors, armed or not. */
static void take_sample(struct guard *g, uint32_t now, const struct thermocouple *readings,
                        int bend_answers, int16_t bend)
{
    real temperatures[CHANNELS], junctions[CHANNELS];
    for (int i = 0; i < CHANNELS; i++) {
        temperatures[i] = readings[i].quarters / R(4);
        junctions[i] = readings[i].sixteenths / R(16);
    }
    uint32_t elapsed = now - g->sample_time;
    real share = least_of(1, elapsed / R(AVERAGING_TIME));
    g->faulty = 0;
    for (int i = 0; i < CHANNELS; i++)
        g->faulty |= readings[i].faults != 0;
    account(g, now);
    if (g->samples || !g->faulty) { /* averages begin with a sample without faults */
        average(g, temperatures, junctions, share);
        g->begun = 1;
    }
    for (int i = 0; i < CHANNELS; i++)
        check_wire(g, i, temperatures[i], readings[i].faults, elapsed, now);
    check_bend(g, bend_answers, bend, share, now);
    for (int i = 0; i < CHANNELS; i++) {
        g->channel[i].heat_given = 0;
        g->channel[i].temperature = temperatures[i];
    }
    g->sample_time = now;
    if (g->begun && g->samples <= SETTLING_SAMPLES)
        g->samples++;
    apply_duty(g, now);
}

/* Return the highest temperature that a wire can have by its heat, °C, in a byte. */
static uint8_t warmest(const struct channel *c)
{
    real most = c->proven ? c->room + c->wire.most + R(0.5) : MAX_WIRE_TEMPERATURE;
    return (uint8_t)least_of(255, most_of(0, most));
}

/* The program. */

static void send_frame(const struct firmware *f, uint8_t type, const void *payload, int size)
{
    uint8_t frame[MAX_FRAME];
    f->board->send(frame, make_frame(frame, type, payload, size));
}

static void send_info(const struct firmware *f)
{
    struct info info = {VERSION, SAMPLE_PERIOD, (int16_t)(4 * TEMPERATURE_LIMIT),
                        {0}, CHANNELS, 1, f->board->reset_cause};
    memcpy(info.serial_number, f->board->serial_number, sizeof info.serial_number);
    send_frame(f, INFO, &info, sizeof info);
}

static void send_sample(struct firmware *f)
{
    const struct guard *g = &f->guard;
    struct sample sample = {
        .sequence = ++f->sequence,
        .time = f->now,
        .challenge = g->challenge,
        .state = g->state,
        .reason = g->reason,
        .acknowledged = g->acknowledged,
        .bend = f->bend,
    };
    struct channel_values values = {.sequence = f->sequence, .channels = CHANNELS};
    for (int i = 0; i < CHANNELS; i++) {
        const struct thermocouple *reading = &f->thermocouple[i];
        values.channel[i].temperature = reading->faults ? NO_READING : reading->quarters;
        values.channel[i].duty = (uint16_t)(FULL_DUTY * f->applied[i] + R(0.5));
        values.channel[i].warmest = warmest(&g->channel[i]);
    }
    for (int copy = 0; copy < 2; copy++) { /* one may get lost */
        send_frame(f, SAMPLE, &sample, sizeof sample);
        send_frame(f, CHANNEL_VALUES, &values, sizeof values);
    }
}

static void handle(struct firmware *f, uint8_t type, const uint8_t *payload)
{
    union {
        struct part part;
        struct arm arm;
        struct command command;
        struct clear clear;
    } frame;
    memcpy(&frame, payload, sizeof frame); /* a pointer to an odd address faults on a Cortex-M0 */
    switch (type) {
    case HELLO:
        send_info(f);
        break;
    case BOUNDS:
        if (frame.part.wire < CHANNELS) {
            f->guard.part[frame.part.wire].part = frame.part;
            f->guard.part[frame.part.wire].received = 1;
        }
        break;
    case ARM:
        take_arm(&f->guard, &frame.arm, f->now);
        break;
    case COMMAND:
        take_command(&f->guard, &frame.command, f->now);
        break;
    case DISARM:
        if (f->guard.state == ARMED)
            trip(&f->guard, BY_HOST, f->now);
        break;
    default:
        take_clear(&f->guard, &frame.clear);
    }
}

static void receive(struct firmware *f)
{
    uint8_t data[64];
    int count = sizeof data;
    for (int turn = 0; turn < 4 && count == sizeof data; turn++) { /* a flood must not hold it up */
        count = f->board->receive(data, sizeof data);
        for (int i = 0; i < count; i++)
            if (take_byte(&f->parser, data[i]) >= 0)
                handle(f, f->parser.body[1], f->parser.body + 2);
    }
}

static void read_sensors(struct firmware *f)
{
    if (f->sequence % THERMOCOUPLE_TURN == 0) {
        for (int i = 0; i < CHANNELS; i++) {
            struct thermocouple reading = read_max31855(f->board->read_thermocouple(i));
            if (reading.faults) /* the reading before is kept */
                f->thermocouple[i].faults = reading.faults;
            else
                f->thermocouple[i] = reading;
        }
    }
    uint8_t data[3]; /* a 0, then a number with its low byte first */
    int answers = f->board->read_bend(data) == 3 && data[0] == 0;
    f->bend = 0;
    if (answers)
        memcpy(&f->bend, data + 1, 2);
    take_sample(&f->guard, f->now, f->thermocouple, answers, f->bend);
}

static void apply(struct firmware *f)
{
    for (int i = 0; i < CHANNELS; i++) {
        real duty = f->guard.channel[i].duty;
        if (f->applied[i] != duty) {
            f->applied[i] = duty;
            f->board->set_duty(i, duty);
        }
    }
    uint8_t latched = f->guard.reason >= LATCHING ? f->guard.reason : 0;
    if (f->remembered != latched) {
        f->remembered = latched;
        f->board->remember(latched);
    }
}

/* Return the reason for which a board that starts is off. */
static uint8_t reason_of_start(const struct board *board)
{
    if (board->reset_cause == POWER_ON)
        return POWER_UP;
    if (board->remembered >= LATCHING)
        return board->remembered;
    int meant = board->reset_cause == PIN_RESET || board->reset_cause == SOFT_RESET;
    return meant ? WAS_RESET : RESTARTED;
}

void start_firmware(struct firmware *f, const struct board *board)
{
    memset(f, 0, sizeof *f);
    f->board = board;
    f->now = f->next = board->ticks();
    f->parser.lost = 1;
    f->remembered = board->remembered;
    begin_guard(&f->guard, f->now, board->random, reason_of_start(board));
    f->applied[0] = f->applied[1] = -1; /* other than any duty */
    apply(f);
}

void step_firmware(struct firmware *f)
{
    uint32_t now = f->board->ticks();
    if (now != f->now)
        f->standing = 0;
    else if (f->standing <= LONGEST_STANDSTILL)
        f->standing++;
    f->now = now;
    if (f->standing > LONGEST_STANDSTILL) /* a watchdog with the same clock stands, too */
        trip(&f->guard, CLOCK_STANDS, now);
    receive(f);
    check_time(&f->guard, now);
    int sampling = (int32_t)(now - f->next) >= 0;
    if (sampling) {
        f->next += SAMPLE_PERIOD;
        if ((int32_t)(f->next - (now + SAMPLE_PERIOD / 2)) < 0)
            f->next = now + SAMPLE_PERIOD / 2;
        read_sensors(f);
    }
    apply(f);
    if (f->guard.state == ARMED && !f->standing)
        f->board->keep_supply();
    if (sampling) {
        send_sample(f);
        f->board->feed(); /* only here, after sensors were read and checked */
    }
}
