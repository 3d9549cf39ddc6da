// As much of Arduino, and of a Teensy 4, as the sketch calls. A test sets and sees it by ctypes.
#pragma once
#include <stdint.h>
#include <string.h>
#include <algorithm>

using std::min;

enum { LOW, HIGH };
enum { INPUT, OUTPUT };
enum { A0 = 14, MSBFIRST = 1, SPI_MODE0 = 0 };

extern "C" {
uint32_t now_us;
uint8_t level[32], mode[32];
int32_t pwm[32];    // of 4096; -1 if the pin is no timer's
uint32_t words[32]; // of the MAX31855 that is selected by a pin
uint8_t bend[3], bend_told[3];
uint8_t received[65536], sent[65536];
uint32_t bend_count, receiving, taken, sending, room, serial_began_well;
uint32_t WDOG3_CS, WDOG3_CNT, WDOG3_WIN, WDOG3_TOVAL, CCM_CCGR5, SNVS_LPGPR0, SRC_SRSR;
void setup();
void loop();
}

#define __IMXRT1062__
#define CCM_CCGR_ON 3
#define CCM_CCGR5_WDOG3(n) (n)
#define IMXRT_WDOG3_ADDRESS 0
#define WDOG_CS_STOP (1 << 0)
#define WDOG_CS_WAIT (1 << 1)
#define WDOG_CS_EN (1 << 7)
#define WDOG_CS_CLK(n) ((n) << 8)
#define WDOG_CS_CMD32EN (1 << 13)
#define WDOG_CS_FLG (1 << 14)
#define SRC_SRSR_IPP_RESET_B (1 << 0)
#define SRC_SRSR_LOCKUP_SYSRESETREQ (1 << 1)
#define SRC_SRSR_WDOG3_RST_B (1 << 7)
inline void __disable_irq() {}
inline void __enable_irq() {}

inline unsigned long millis() { return now_us / 1000; }
inline unsigned long micros() { return now_us; }
inline void delayMicroseconds(unsigned us) { now_us += us; }
inline int analogRead(uint8_t) { return now_us % 3; }
inline void analogWriteResolution(int) {}
inline void analogWriteFrequency(uint8_t, float) {}
inline void analogWrite(uint8_t pin, int value) { pwm[pin] = value; }
inline void pinMode(uint8_t pin, uint8_t to)
{
    mode[pin] = to;
    pwm[pin] = -1;
}

static int bits; // of a word, which were read since a pin selected its amplifier
inline void digitalWrite(uint8_t pin, uint8_t to)
{
    level[pin] = to;
    bits = 0;
}

struct SPISettings {
    SPISettings(int, int, int) {}
};
static struct {
    void begin() {}
    void beginTransaction(SPISettings) {}
    void endTransaction() {}
    uint8_t transfer(uint8_t)
    {
        uint8_t byte = 0xFF;
        for (int pin : {9, 10})
            if (!level[pin])
                byte = words[pin] >> (24 - bits);
        bits += 8;
        return byte;
    }
} SPI;

static struct {
    int left;
    void begin() {}
    void beginTransmission(uint8_t) {}
    void write(const uint8_t *data, int size) { memcpy(bend_told, data, size); }
    void endTransmission() {}
    void requestFrom(uint8_t address, uint8_t) { left = address == 0x12 ? bend_count : 0; }
    int available() { return left; }
    int read() { return bend[bend_count - left--]; }
} Wire;

static struct {
    void begin(unsigned long)
    {
        bool low = mode[3] == OUTPUT && mode[5] == OUTPUT && !level[3] && !level[5];
        serial_began_well = low && !(WDOG3_CS & WDOG_CS_EN);
    }
    int available() { return receiving - taken; }
    int read() { return received[taken++]; }
    int availableForWrite() { return room; }
    void write(const uint8_t *data, int size)
    {
        memcpy(sent + sending, data, size);
        sending += size;
    }
} Serial;
