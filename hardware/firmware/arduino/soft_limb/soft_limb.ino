// A soft limb's firmware for Teensy 4.0 and 4.1, and for Arduino UNO R4 Minima and WiFi.
//
// Pins and chips are here, the board's program is in core.c, and the wiring is in README.md two
// folders up. No board has run this sketch yet: check yours by `soft-limb board-check PORT`, first
// with the wires' supply off.

#include <SPI.h>
#include <Wire.h>

#include "core.h"

// ---- Settings that you may change ---------------------------------------------------------------

static const uint8_t HEATERS[] = {3, 5};         // gates of left, right: PWM of different timers
static const uint8_t CHIP_SELECTS[] = {9, 10};   // MAX31855 of left, right; SCK is 13, MISO is 12
static const uint8_t SUPPLY = 7;                 // charge pump that holds the supply's relay
static const uint8_t NOISE_PIN = A0;             // leave it open: its noise is the first challenge
static const uint8_t BEND_ADDRESS = 0x12;        // of the Bend Labs one-axis sensor, at SDA and SCL
static const char SERIAL_NUMBER[] = "LIMB0001";  // eight characters, other ones for each board
#define HOST Serial                              // USB; Serial1 for an adapter at pins 0 and 1

// ---- The chip: watchdog, cause of the last reset, a word that outlives one, PWM ----------------

static const unsigned long BAUD = 115200;
static const float PWM_FREQUENCY = 1000;  // Hz
static const unsigned PASS_PAUSE = 500;   // us, between two passes, not counted by `ticks`

#if defined(__IMXRT1062__)  // Teensy 4.0 and 4.1

static void start_watchdog()
{
    // Watchdog 3, as the others take 0.5 s at least. It counts an oscillator of its own, and after
    // this nothing can change it until the next reset.
    CCM_CCGR5 |= CCM_CCGR5_WDOG3(CCM_CCGR_ON);
    __disable_irq();
    if (WDOG3_CS & WDOG_CS_CMD32EN) {
        WDOG3_CNT = 0xD928C520;
    } else {
        volatile uint16_t *count = (volatile uint16_t *)(IMXRT_WDOG3_ADDRESS + 4);
        *count = 0xC520;
        *count = 0xD928;
    }
    WDOG3_WIN = 0;
    WDOG3_TOVAL = 200 * 32768 / 1000;  // 200 ms
    WDOG3_CS = WDOG_CS_FLG | WDOG_CS_CMD32EN | WDOG_CS_CLK(1) | WDOG_CS_EN | WDOG_CS_WAIT |
               WDOG_CS_STOP;
    __enable_irq();
}

static void feed() { WDOG3_CNT = 0xB480A602; }

static uint32_t kept() { return SNVS_LPGPR0; }

static void keep(uint32_t word) { SNVS_LPGPR0 = word; }

static uint8_t find_reset_cause(bool survived)
{
    uint32_t why = SRC_SRSR;
    SRC_SRSR = why;  // ones clear it
    if (why & SRC_SRSR_WDOG3_RST_B)
        return WATCHDOG_RESET;
    if (why & SRC_SRSR_LOCKUP_SYSRESETREQ)
        return LOCKUP_RESET;  // or Teensy's handler of faults, which does the same
    if (why & SRC_SRSR_IPP_RESET_B)  // by the loader's chip: a power-up, too, looks like this
        return survived ? PIN_RESET : POWER_ON;
    return UNKNOWN_RESET;
}

static int room_to_send() { return HOST.availableForWrite(); }

static void start_chip()
{
    analogWriteResolution(12);
    for (uint8_t pin : HEATERS)
        analogWriteFrequency(pin, PWM_FREQUENCY);
}

static void set_duty(int wire, real duty)
{
    if (duty > 0) {
        analogWrite(HEATERS[wire], (int)(4096 * duty + 0.5f));
    } else {  // takes the pin from the timer, too
        digitalWrite(HEATERS[wire], LOW);
        pinMode(HEATERS[wire], OUTPUT);
    }
}

#elif defined(ARDUINO_UNOR4_MINIMA) || defined(ARDUINO_UNOR4_WIFI)

#include <WDT.h>
#include <pwm.h>

static PwmOut pwm[] = {PwmOut(HEATERS[0]), PwmOut(HEATERS[1])};

static void start_watchdog() { WDT.begin(170); }  // ms; the next longer one that it has is 349 ms

static void feed() { WDT.refresh(); }

// The backup registers; the loader uses the first four.
static uint32_t kept()
{
    uint32_t word = 0;
    for (int i = 7; i >= 4; i--)
        word = word << 8 | R_SYSTEM->VBTBKR[i];
    return word;
}

static void keep(uint32_t word)
{
    R_BSP_RegisterProtectDisable(BSP_REG_PROTECT_OM_LPC_BATT);
    for (int i = 4; i < 8; i++, word >>= 8)
        R_SYSTEM->VBTBKR[i] = (uint8_t)word;
    R_BSP_RegisterProtectEnable(BSP_REG_PROTECT_OM_LPC_BATT);
}

static uint8_t find_reset_cause(bool survived)
{
    uint8_t power = R_SYSTEM->RSTSR0;
    uint16_t other = R_SYSTEM->RSTSR1;
    R_SYSTEM->RSTSR0 = 0;  // or a cause would stay for the next start
    R_SYSTEM->RSTSR1 = 0;
    if (other & (R_SYSTEM_RSTSR1_WDTRF_Msk | R_SYSTEM_RSTSR1_IWDTRF_Msk))
        return WATCHDOG_RESET;
    if (other & ~R_SYSTEM_RSTSR1_SWRF_Msk || power & ~R_SYSTEM_RSTSR0_PORF_Msk)
        return UNKNOWN_RESET;  // the memory, or the voltage
    if (power && !survived)
        return POWER_ON;
    return other ? SOFT_RESET : PIN_RESET;
}

inline int room_of(_SerialUSB &port) { return port.availableForWrite(); }
inline int room_of(UART &) { return 8; }  // does not say, and its write waits 0.09 ms for each byte

static int room_to_send() { return room_of(HOST); }

static void start_chip()
{
    // Not by analogWrite, which begins at half duty.
    for (PwmOut &output : pwm)
        output.begin(PWM_FREQUENCY, 0.0f);
    Wire.setWireTimeout(10000);  // us; else 0.1 s
}

static void set_duty(int wire, real duty) { pwm[wire].pulse_perc(100 * duty); }

#else
#error "Write for this chip what the Teensy has above: see README.md, Another chip."
#endif

// ---- The board, for both chips -------------------------------------------------------------------

static_assert(sizeof SERIAL_NUMBER == 9, "SERIAL_NUMBER must have eight characters");

static const uint32_t KEY = 0x5AC30000;  // marks a kept word; a power-up leaves another word

static board limb;
static firmware program;
static uint32_t word_kept;  // key, count of starts, reason
static uint8_t outgoing[4 * MAX_FRAME];
static int waiting;  // bytes of it

static void gates_low()
{
    for (uint8_t pin : HEATERS) {
        digitalWrite(pin, LOW);
        pinMode(pin, OUTPUT);
    }
}

static uint32_t ticks() { return millis(); }

static void drain()
{
    int count = min(room_to_send(), waiting);
    if (count <= 0)
        return;
    HOST.write(outgoing, (size_t)count);
    waiting -= count;
    memmove(outgoing, outgoing + count, (size_t)waiting);
}

static int receive(uint8_t *data, int room)
{
    drain();
    int count = 0;
    while (count < room && HOST.available() > 0) {
        int byte = HOST.read();
        if (byte < 0)
            break;
        data[count++] = (uint8_t)byte;
    }
    return count;
}

static void send(const uint8_t *data, int size)
{
    if (waiting + size <= (int)sizeof outgoing) {  // else nobody listens, and it is lost
        memcpy(outgoing + waiting, data, (size_t)size);
        waiting += size;
    }
    drain();
}

static uint32_t read_thermocouple(int wire)
{
    uint32_t word = 0;
    SPI.beginTransaction(SPISettings(1000000, MSBFIRST, SPI_MODE0));
    digitalWrite(CHIP_SELECTS[wire], LOW);
    delayMicroseconds(1);
    for (int i = 0; i < 4; i++)
        word = word << 8 | SPI.transfer(0);
    digitalWrite(CHIP_SELECTS[wire], HIGH);
    SPI.endTransaction();
    return word;
}

static int read_bend(uint8_t *data)
{
    Wire.requestFrom(BEND_ADDRESS, (uint8_t)3);
    int count = 0;
    while (Wire.available() > 0 && count < 3)
        data[count++] = (uint8_t)Wire.read();
    return count;
}

static void keep_supply()
{
    static bool high = false;
    high = !high;
    digitalWrite(SUPPLY, high ? HIGH : LOW);
}

static void remember(uint8_t reason)
{
    word_kept = (word_kept & ~0xFFUL) | reason;
    keep(word_kept);
}

static uint16_t first_challenge()
{
    uint32_t number = word_kept;  // its count differs at each start, unless the power was off
    for (int i = 0; i < 64; i++)
        number = number * 1664525 + 1013904223 + (uint32_t)analogRead(NOISE_PIN) + micros();
    return (uint16_t)(number >> 16);
}

void setup()
{
    gates_low();
    HOST.begin(BAUD);  // a Teensy's USB waits for a computer here, for longer than the watchdog
    start_watchdog();
    pinMode(SUPPLY, OUTPUT);
    for (uint8_t pin : CHIP_SELECTS) {
        digitalWrite(pin, HIGH);
        pinMode(pin, OUTPUT);
    }
    SPI.begin();
    Wire.begin();
    start_chip();

    word_kept = kept();
    bool is_word = (word_kept & 0xFFFF0000) == KEY;
    limb.reset_cause = find_reset_cause(is_word);
    limb.remembered = is_word ? (uint8_t)word_kept : 0;
    uint32_t count = is_word ? (word_kept >> 8) + 1 : 0;
    word_kept = KEY | (count & 0xFF) << 8;
    remember(limb.remembered);
    limb.random = first_challenge();
    memcpy(limb.serial_number, SERIAL_NUMBER, sizeof limb.serial_number);

    limb.ticks = ticks;
    limb.receive = receive;
    limb.send = send;
    limb.read_thermocouple = read_thermocouple;
    limb.read_bend = read_bend;
    limb.set_duty = set_duty;
    limb.keep_supply = keep_supply;
    limb.feed = feed;
    limb.remember = remember;

    static const uint8_t RUN[] = {0, 1, 0};  // the bend sensor measures from now on
    Wire.beginTransmission(BEND_ADDRESS);
    Wire.write(RUN, sizeof RUN);
    Wire.endTransmission();  // its silence is noticed at the first sample

    start_firmware(&program, &limb);
}

void loop()
{
    step_firmware(&program);
    delayMicroseconds(PASS_PAUSE);
}
