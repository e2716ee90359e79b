/* The flash controller's own program in a simulated ATmega328P, for tests: `unlit-sim PROGRAM.hex [BOOTLOADER.hex]`,
 * with - for no program.
 * Links libsimavr, which is GPL-3; nothing of unlit links this.
 *
 * The UART is a pseudo terminal, whose path is the first line of stdout. Commands come line by line on stdin, each is
 * answered by one line, after what it caused:
 *
 *   run US [TEXT]            lets time pass, as fast as it can, or until the board has sent a line that starts so
 *   pace real|step           real: time passes by the wall clock; step (at start): only by `run`
 *   uart pty|stdio|off       where the board's UART leads: the terminal, `say` and "<" lines, or nowhere
 *   say TEXT                 bytes to the board at line rate, with a line end; \xHH for any byte
 *   contact US=LEVEL ...     the sync contact closes (1) or opens (0) so long from now; bounce is several of them
 *   ready 0|1                the flash's ready output
 *   supply MILLIVOLTS        the board's supply, 5000 at start; the light on the diode stays what it is
 *   light KEY=VALUE ...      dark noise flicker hz energy jitter recycle seed; see light.h
 *   reset                    pulls the reset pin, as DTR does on an Uno
 *   flash ADDRESS WORD       overwrites a word of the program (hexadecimal); answers what stood there
 *   stack                    bytes of RAM that nothing has used since the last reset
 *   unplug | plug            takes the terminal away; gives a new one and answers its path
 *   quit
 *
 * Answers: "ok [...]", for `run` with the cycle it ended at, or "err WHY". In between, what happened:
 *
 *   ! trigger CYCLE LEVEL    ! contact CYCLE LEVEL    ! armed CYCLE LEVEL (the LED)
 *   ! light CYCLE ENERGY     the flash fired           ! reset CYCLE      ! crashed CYCLE
 *   < LINE                   the board said (uart stdio)
 *
 * Of simavr 1.6 one must know: a pin's level lasts only with SET_EXTERNAL, because every write to the port puts the
 * pull-ups back, and an unchanged one is not written again after a reset has cleared PIND; the ADC's result is what
 * its pin has when the result is read; a reset clears RAM and forgets all cycle timers; an interrupt is served
 * between instructions but costs no response cycles, of which the chip takes four and, for its synchroniser, up to
 * two; its UART counts 11 bits a byte, so the line is 8 % slower than a real one; and its EEPROM writes last no
 * time. */
#define _GNU_SOURCE
#include "hex.h"
#include "light.h"
#include "uart.h"

#include <avr_adc.h>
#include <avr_ioport.h>
#include <poll.h>
#include <sim_avr.h>
#include <sim_time.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { HZ = 16000000, SYNC_PIN = 2, TRIGGER_PIN = 4, READY_PIN = 7, ARMED_PIN = 5 };
enum { VOLT_MV = 5000, UNUSED = 0xC5, RAM_START = 0x100, PIND = 0x29 };

static avr_t *avr;
static FILE *out;
static struct light light = { .dark = 12.3, .noise = 0.5, .flicker_hz = 100, .energy = 1, .random = 1 };
static bool real_time, was_reset, contact_closed, ready = true, trigger_high, armed_lit;

/* The start of the line that `run` waits for. */
static const char *awaited;
static bool heard_awaited;

struct edge {
    avr_cycle_count_t at;
    bool closed;
};
static struct edge edges[1024];
static size_t edge_count, edge_next;

static void tell(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vfprintf(out, format, arguments);
    va_end(arguments);
    fputc('\n', out);
}

static double now_us(void)
{
    return (double)avr->cycle / (HZ / 1000000);
}

static void die(const char *why)
{
    fprintf(stderr, "unlit-sim: %s\n", why);
    exit(1);
}

/* ---- pins ---- */

static avr_irq_t *pin(char port, int bit)
{
    return avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit);
}

static void drive_pins(void)
{
    avr_ioport_external_t levels = { .name = 'D', .mask = 1u << SYNC_PIN | 1u << READY_PIN };
    levels.value = (contact_closed ? 0u : 1u << SYNC_PIN) | (ready ? 1u << READY_PIN : 0u);
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &levels);
    avr->data[PIND] = (uint8_t)((avr->data[PIND] & ~levels.mask) | levels.value);
    avr_raise_irq(pin('D', SYNC_PIN), !contact_closed);
    avr_raise_irq(pin('D', READY_PIN), ready);
}

static avr_cycle_count_t next_edge(avr_t *of, avr_cycle_count_t when, void *unused)
{
    (void)of, (void)when, (void)unused;
    while (edge_next < edge_count && edges[edge_next].at <= avr->cycle) {
        contact_closed = edges[edge_next++].closed;
        tell("! contact %llu %d", (unsigned long long)avr->cycle, contact_closed);
        drive_pins();
    }
    return edge_next < edge_count ? edges[edge_next].at : 0;
}

static void set_trigger(bool high)
{
    if (high == trigger_high) {
        return;
    }
    trigger_high = high;
    tell("! trigger %llu %d", (unsigned long long)avr->cycle, high);
    if (high) {
        tell("! light %llu %.6f", (unsigned long long)avr->cycle, light_fire(&light, now_us()));
    }
}

static void on_trigger(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    set_trigger(value != 0);
}

static void on_armed(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    if ((value != 0) != armed_lit) {
        armed_lit = value != 0;
        tell("! armed %llu %d", (unsigned long long)avr->cycle, armed_lit);
    }
}

/* ---- ADC ---- */

/* The least voltage that, against the chip's own reference, simavr turns into so many counts. */
static uint32_t millivolts(uint32_t counts)
{
    return (counts * ADC_VREF_V110 + 1022) / 1023;
}

static void on_conversion(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)value, (void)unused;
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0), millivolts(light_sample(&light, now_us())));
}

static void on_line(const char *line)
{
    if (uart_leads_to() == UART_STDIO) {
        tell("< %s", line);
    }
    heard_awaited |= awaited != NULL && strncmp(line, awaited, strlen(awaited)) == 0;
}

/* ---- time ---- */

static void on_reset(avr_t *of)
{
    (void)of;
    was_reset = true;
}

/* simavr has forgotten the timers and cleared the pins and the RAM, which in a chip holds anything. */
static void after_reset(void)
{
    was_reset = false;
    tell("! reset %llu", (unsigned long long)avr->cycle);
    set_trigger(false); /* a pin of a chip in reset is an input, and the resistor pulls it low */
    on_armed(NULL, 0, NULL);
    memset(avr->data + RAM_START, UNUSED, avr->ramend + 1u - RAM_START);
    drive_pins();
    uart_reset();
    if (edge_next < edge_count) {
        const avr_cycle_count_t at = edges[edge_next].at;
        avr_cycle_timer_register(avr, at > avr->cycle ? at - avr->cycle : 1, next_edge, NULL);
    }
}

static void no_sleep(avr_t *of, avr_cycle_count_t cycles)
{
    (void)of, (void)cycles;
}

static avr_cycle_count_t stop_here(avr_t *of, avr_cycle_count_t when, void *unused)
{
    (void)of, (void)when, (void)unused;
    return 0;
}

static void run_until(avr_cycle_count_t end)
{
    if (end <= avr->cycle) {
        return;
    }
    avr_cycle_timer_register(avr, end - avr->cycle, stop_here, NULL);
    while (avr->cycle < end && !heard_awaited) {
        const int state = avr_run(avr);
        if (was_reset) {
            after_reset();
        }
        if (state == cpu_Done || state == cpu_Crashed) {
            tell("! crashed %llu", (unsigned long long)avr->cycle);
            die("the simulated processor has crashed");
        }
    }
    avr_cycle_timer_cancel(avr, stop_here, NULL);
}

static uint64_t wall_ns(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (uint64_t)time.tv_sec * 1000000000u + (uint64_t)time.tv_nsec;
}

/* Follows the wall clock in slices of a millisecond, between which bytes and commands come in. More than 20 ms that
 * the machine did not give us are left out: the board's time then stands still, which is what its host sees too. */
static void keep_pace(void)
{
    static uint64_t last;
    const uint64_t now = wall_ns();
    uint64_t gone = now - last;
    last = now;
    if (gone > 20000000u) {
        gone = 1000000u;
    }
    const avr_cycle_count_t end = avr->cycle + gone * 16u / 1000u;
    while (avr->cycle < end) {
        uart_read_terminal();
        const avr_cycle_count_t slice = avr->cycle + HZ / 1000;
        run_until(slice < end ? slice : end);
    }
}

/* ---- commands ---- */

static int by_time(const void *left, const void *right)
{
    const struct edge *a = left, *b = right;
    return a->at < b->at ? -1 : a->at > b->at;
}

static bool command_contact(char *words)
{
    memmove(edges, edges + edge_next, (edge_count - edge_next) * sizeof *edges);
    edge_count -= edge_next;
    edge_next = 0;
    char *rest = NULL;
    for (char *word = strtok_r(words, " ", &rest); word != NULL; word = strtok_r(NULL, " ", &rest)) {
        double us = 0;
        int closed = 0;
        if (sscanf(word, "%lf=%d", &us, &closed) != 2 || us < 0 || edge_count == sizeof edges / sizeof *edges) {
            return false;
        }
        edges[edge_count++] = (struct edge){ avr->cycle + 1 + (avr_cycle_count_t)(us * (HZ / 1000000)), closed != 0 };
    }
    qsort(edges, edge_count, sizeof *edges, by_time);
    avr_cycle_timer_cancel(avr, next_edge, NULL);
    if (edge_count > 0) {
        avr_cycle_timer_register(avr, edges[0].at > avr->cycle ? edges[0].at - avr->cycle : 1, next_edge, NULL);
    }
    return edge_count > 0;
}

static bool command_light(char *words)
{
    char *rest = NULL;
    for (char *word = strtok_r(words, " ", &rest); word != NULL; word = strtok_r(NULL, " ", &rest)) {
        char key[16];
        double value = 0;
        if (sscanf(word, "%15[a-z]=%lf", key, &value) != 2) {
            return false;
        }
        double *target = strcmp(key, "dark") == 0    ? &light.dark
                         : strcmp(key, "noise") == 0   ? &light.noise
                         : strcmp(key, "flicker") == 0 ? &light.flicker
                         : strcmp(key, "hz") == 0      ? &light.flicker_hz
                         : strcmp(key, "energy") == 0  ? &light.energy
                         : strcmp(key, "jitter") == 0  ? &light.jitter
                         : strcmp(key, "recycle") == 0 ? &light.recycle_us
                                                       : NULL;
        if (target != NULL) {
            *target = value;
        } else if (strcmp(key, "seed") == 0 && value >= 1) {
            light.random = (uint64_t)value * UINT64_C(0x9E3779B97F4A7C15);
        } else {
            return false;
        }
    }
    return true;
}

static bool command_say(const char *text)
{
    uint8_t bytes[1024];
    size_t count = 0;
    while (*text != '\0' && count + 1 < sizeof bytes) {
        unsigned byte = 0;
        if (text[0] == '\\' && text[1] == 'x' && sscanf(text + 2, "%2x", &byte) == 1) {
            bytes[count++] = (uint8_t)byte;
            text += 4;
        } else {
            bytes[count++] = (uint8_t)*text++;
        }
    }
    bytes[count++] = '\n';
    uart_to_board(bytes, count);
    return true;
}

static void command_stack(void)
{
    size_t longest = 0, run = 0;
    for (size_t at = RAM_START; at <= avr->ramend; at++) {
        run = avr->data[at] == UNUSED ? run + 1 : 0;
        longest = run > longest ? run : longest;
    }
    tell("ok %zu", longest);
}

static void command_flash(const char *words)
{
    unsigned address = 0, word = 0;
    if (sscanf(words, "%x %x", &address, &word) != 2 || address + 1 > avr->flashend) {
        tell("err flash wants an address and a word, both hexadecimal");
        return;
    }
    tell("ok %04x", (unsigned)(avr->flash[address] | avr->flash[address + 1] << 8));
    avr->flash[address] = (uint8_t)word;
    avr->flash[address + 1] = (uint8_t)(word >> 8);
}

static void command_run(const char *words)
{
    static char prefix[64];
    double us = 0;
    prefix[0] = '\0';
    if (real_time || sscanf(words, "%lf %63[^\n]", &us, prefix) < 1) {
        tell("err run wants microseconds, and pace step");
        return;
    }
    heard_awaited = false;
    awaited = prefix[0] != '\0' ? prefix : NULL;
    run_until(avr->cycle + (avr_cycle_count_t)(us * (HZ / 1000000)));
    awaited = NULL;
    heard_awaited = false;
    tell("ok %llu", (unsigned long long)avr->cycle);
}

static void command(char *line)
{
    char *words = strchr(line, ' ');
    if (words != NULL) {
        *words++ = '\0';
    } else {
        words = line + strlen(line);
    }
    bool done = true;
    if (strcmp(line, "run") == 0) {
        command_run(words);
        return;
    } else if (strcmp(line, "flash") == 0) {
        command_flash(words);
        return;
    } else if (strcmp(line, "stack") == 0) {
        command_stack();
        return;
    } else if (strcmp(line, "plug") == 0) {
        char path[64];
        tell(uart_plug(path, sizeof path) ? "ok %s" : "err it is plugged in, or there are no terminals", path);
        return;
    } else if (strcmp(line, "pace") == 0) {
        done = strcmp(words, "real") == 0 || strcmp(words, "step") == 0;
        real_time = strcmp(words, "real") == 0;
    } else if (strcmp(line, "uart") == 0) {
        done = strcmp(words, "pty") == 0 || strcmp(words, "stdio") == 0 || strcmp(words, "off") == 0;
        uart_lead_to(strcmp(words, "pty") == 0 ? UART_PTY : strcmp(words, "stdio") == 0 ? UART_STDIO : UART_OFF);
    } else if (strcmp(line, "say") == 0) {
        done = command_say(words);
    } else if (strcmp(line, "contact") == 0) {
        done = command_contact(words);
    } else if (strcmp(line, "ready") == 0) {
        ready = strcmp(words, "1") == 0;
        drive_pins();
    } else if (strcmp(line, "supply") == 0) {
        avr->vcc = avr->avcc = avr->aref = (uint32_t)strtoul(words, NULL, 10);
        done = avr->vcc > 0;
    } else if (strcmp(line, "light") == 0) {
        done = command_light(words);
    } else if (strcmp(line, "reset") == 0) {
        avr_reset(avr);
        avr_regbit_set(avr, avr->reset_flags.extrf);
        after_reset();
    } else if (strcmp(line, "unplug") == 0) {
        uart_unplug();
    } else if (strcmp(line, "quit") == 0) {
        exit(0);
    } else {
        done = false;
    }
    tell(done ? "ok" : "err not understood");
}

/* Takes the whole lines that have come on stdin. */
static void read_commands(void)
{
    static char buffer[4096];
    static size_t length;
    const ssize_t count = read(STDIN_FILENO, buffer + length, sizeof buffer - length);
    if (count <= 0) {
        exit(0); /* whoever started us is gone */
    }
    length += (size_t)count;
    char *end = NULL;
    while ((end = memchr(buffer, '\n', length)) != NULL) {
        *end = '\0';
        command(buffer);
        const size_t used = (size_t)(end + 1 - buffer);
        memmove(buffer, buffer + used, length - used);
        length -= used;
    }
    if (length == sizeof buffer) {
        die("a command is longer than 4096 bytes");
    }
}

/* Returns where the program begins. */
static avr_flashaddr_t load(const char *path)
{
    size_t begin = 0;
    if (!hex_load(path, avr->flash, avr->flashend + 1u, &begin)) {
        die("the program cannot be loaded");
    }
    return (avr_flashaddr_t)begin;
}

int main(int count, char **arguments)
{
    if (count != 2 && count != 3) {
        fprintf(stderr, "usage: unlit-sim PROGRAM.hex [BOOTLOADER.hex]\n");
        return 2;
    }
    /* simavr prints to stdout; that is kept for the answers. */
    out = fdopen(dup(STDOUT_FILENO), "w");
    if (out == NULL || dup2(STDERR_FILENO, STDOUT_FILENO) < 0) {
        die("no stdout");
    }
    setvbuf(out, NULL, _IOFBF, 1 << 16);

    avr = avr_make_mcu_by_name("atmega328p");
    if (avr == NULL || avr_init(avr) != 0) {
        die("simavr has no atmega328p");
    }
    avr->frequency = HZ;
    avr->vcc = avr->avcc = avr->aref = VOLT_MV;
    avr->codeend = avr->flashend;
    avr->log = LOG_NONE;
    avr->sleep = no_sleep;
    avr->reset = on_reset;
    if (strcmp(arguments[1], "-") != 0) {
        load(arguments[1]);
    }
    if (count == 3) {
        avr->reset_pc = avr->pc = load(arguments[2]); /* as the fuse BOOTRST has it */
    }
    uart_attach(avr, on_line);
    avr_irq_register_notify(pin('D', TRIGGER_PIN), on_trigger, NULL);
    avr_irq_register_notify(pin('B', ARMED_PIN), on_armed, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), on_conversion, NULL);

    char path[64];
    if (!uart_plug(path, sizeof path)) {
        die("there are no pseudo terminals");
    }
    tell("%s", path);
    avr_regbit_set(avr, avr->reset_flags.porf);
    after_reset();

    for (;;) {
        fflush(out);
        struct pollfd stdin_ready = { .fd = STDIN_FILENO, .events = POLLIN };
        if (poll(&stdin_ready, 1, real_time ? 1 : -1) > 0) {
            read_commands();
        }
        if (real_time) {
            keep_pace();
        }
    }
}
