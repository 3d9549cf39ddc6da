/* Plays recorded episodes to the core: what its board answers comes from a file, and all that the
core does to its board goes to another one. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"

static FILE *answers, *calls;
static uint8_t incoming[1 << 16];
static unsigned waiting, taken, heard; /* bytes from the host; heard: whether asked in this pass */

static uint32_t number(int size)
{
    uint32_t value = 0;
    for (int i = 0; i < size; i++)
        value |= (uint32_t)fgetc(answers) << 8 * i;
    return value;
}

static void read_answers(uint8_t *data, unsigned size)
{
    if (fread(data, 1, size, answers) != size)
        exit(1);
}

static void note(char what, const void *data, int size)
{
    fputc(what, calls);
    fwrite(data, 1, size, calls);
}

static uint32_t ticks(void) { return number(4); }
static uint32_t read_thermocouple(int wire) { note('V', &wire, 1); return number(4); }
static void send(const uint8_t *data, int size) { note('S', data, size); }
static void keep_supply(void) { note('K', "", 0); }
static void feed(void) { note('F', "", 0); }
static void remember(uint8_t reason) { note('R', &reason, 1); }

static int receive(uint8_t *data, int room)
{
    if (!heard++)
        taken = 0, waiting = number(2), read_answers(incoming, waiting);
    int size = waiting - taken < (unsigned)room ? (int)(waiting - taken) : room;
    memcpy(data, incoming + taken, size);
    taken += size;
    return size;
}

static int read_bend(uint8_t *data)
{
    int size = number(1);
    read_answers(data, size);
    return size;
}

static void set_duty(int wire, real duty)
{
    note('D', &wire, 1);
    note('=', &duty, sizeof duty);
}

#ifdef __arm__ /* A reset: the stack, and where to begin, at address 0. */
void _start(void);
static void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xF << 20; /* CPACR: lets a Cortex-M4F use its FPU */
    _start();
}
__attribute__((section(".vectors"), used)) static const void *const vectors[] = {
    (void *)0x20400000, (void *)reset};
#endif

int main(void)
{
    answers = fopen("answers.bin", "rb"), calls = fopen("calls.bin", "wb");
    struct board board = {ticks, receive, send, read_thermocouple, read_bend, set_duty, keep_supply,
                          feed, remember, 0, 0, 0, "paper"};
    for (unsigned passes; (passes = number(2)) && !feof(answers);) {
        struct firmware firmware;
        board.reset_cause = number(1), board.remembered = number(1), board.random = number(2);
        start_firmware(&firmware, &board);
        while (passes--)
            heard = 0, step_firmware(&firmware);
    }
    return fclose(calls);
}
