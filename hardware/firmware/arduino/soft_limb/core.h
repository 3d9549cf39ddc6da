/* The board's program, for any board: docs/protocol.md in portable C.

It is the program of protocol.py, readings.py, heat.py, guard.py and firmware.py, in the same order,
and a test compares the calls of both. It needs no heap and nothing of Arduino. */

#ifndef SOFT_LIMB_CORE_H
#define SOFT_LIMB_CORE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef REAL /* double only to compare it with the Python firmware */
#define REAL float
#endif
typedef REAL real;

enum { CHANNELS = 2 }; /* wires, each with its thermocouple: left, right */

/* Causes of a reset. */
enum { POWER_ON, PIN_RESET, WATCHDOG_RESET, SOFT_RESET, LOCKUP_RESET, UNKNOWN_RESET };

/* The functions and values of a board that the program calls and reads. No function may wait. */
struct board {
    uint32_t (*ticks)(void);                     /* ms; wraps after 49 days */
    int (*receive)(uint8_t *data, int room);     /* bytes from the host; returns how many */
    void (*send)(const uint8_t *data, int size); /* a whole frame, which may get lost */
    uint32_t (*read_thermocouple)(int wire);     /* the 32 bits of its MAX31855 */
    int (*read_bend)(uint8_t *data);             /* 3 bytes of the bend sensor; returns how many */
    void (*set_duty)(int wire, real duty);       /* PWM, duty in [0, 1] */
    void (*keep_supply)(void);                   /* holds the relay for some passes of the loop */
    void (*feed)(void);                          /* the watchdog */
    void (*remember)(uint8_t reason);            /* outlives a reset, is `remembered` after it */
    uint8_t reset_cause, remembered;
    uint16_t random; /* another one at each start */
    uint8_t serial_number[8];
};

enum { MAX_PAYLOAD = 24, MAX_BODY = 2 + MAX_PAYLOAD + 4, MAX_FRAME = 2 + 2 * MAX_BODY };

struct parser {             /* of frames from the host */
    uint8_t body[MAX_BODY]; /* version, type, payload, CRC */
    uint8_t size, escaping, lost; /* lost: skips up to the next flag; 1 at the start */
};

#pragma pack(push, 1)
struct bounds {                 /* of a wire */
    uint16_t a1_slow, a1_fast;  /* 1/1000 1/s */
    uint16_t a2_least, a2_most; /* 1/100 °C/s */
    uint16_t a3_slow;           /* 1/1000 1/s */
};
struct part { /* a BOUNDS: the part of an arming for a wire */
    uint16_t challenge;
    uint8_t wire;
    struct bounds bounds;
    uint8_t pull; /* 0: to the right, 16: to the left */
};
#pragma pack(pop)

struct thermocouple {
    int16_t quarters, sixteenths; /* temperature in 1/4 °C, the amplifier's in 1/16 °C */
    uint8_t faults;               /* bits 0 to 2 are a MAX31855's; 3: bits that it never sends */
};

struct wire { /* lowest and highest temperature by its duty; °C above the room */
    real a1_slow, a1_fast, a2_least, a2_most, a3_slow; /* bounds, 1/s and °C/s */
    real least, least_reading, most, silicone, hidden, shortfall;
};

struct channel { /* a wire and its thermocouple; °C */
    struct wire wire;
    uint8_t proven; /* whether it has followed some heat */
    uint8_t hot, bad; /* samples in series above the limit, and without a reading */
    int8_t side;      /* to which the wire bends the limb: 1 right, -1 left, 0 before an ARM */
    real duty, commanded, allowed;
    real heat_given; /* duty times ms since the last sample */
    real temperature, average, trend, junction, unheated, offset, room;
    real still;     /* a reading that may stand still, */
    uint32_t moved; /* and the time of its last change, ms */
};

struct guard {
    uint8_t state, reason, late, faulty;
    uint8_t begun, samples;        /* all wires were read; number of samples since, up to 11 */
    uint8_t has_bend, equal_bends; /* equal_bends: equal readings in series */
    int16_t bend;                  /* 1/64 degrees */
    uint16_t challenge, session;
    uint16_t acknowledged;                    /* sequence of the last command */
    uint32_t command_time, answered_time;     /* of it, and of the sample that it answers, ms */
    uint32_t heat_counted_until, sample_time; /* ms */
    real total;                               /* largest sum of both duties */
    real tip, tip_before;     /* the averaged bend: now, and when it last moved; */
    real pull_low, pull_high; /* since then, °C of right minus left */
    struct channel channel[CHANNELS];
    struct {
        uint8_t received;
        struct part part;
    } part[CHANNELS]; /* the last BOUNDS of each wire */
};

struct firmware {
    const struct board *board;
    struct guard guard;
    struct parser parser;
    struct thermocouple thermocouple[CHANNELS];
    int16_t bend;
    uint32_t next, now;           /* sample and pass, ms */
    uint8_t standing, remembered; /* standing: passes in which the clock stood still */
    uint16_t sequence;
    real applied[CHANNELS];
};

/* Once, before anything else. Both duties are set to zero. */
void start_firmware(struct firmware *firmware, const struct board *board);

/* One pass of the loop. There must be a hundred per second at least, and so few that the clock goes
on within fifty of them: else it stands still, and the board switches off. */
void step_firmware(struct firmware *firmware);

#ifdef __cplusplus
}
#endif

#endif
