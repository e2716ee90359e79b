/* The flash controller's logic: who may let the sync contact through to the flash, when, and what light came.
 * No registers, no heap, no clock of its own: the platform passes the time in microseconds (modulo 2^32) to
 * every call and gives its pins as functions. ../PROTOCOL.md is the spec of what is said over the wire.
 *
 * The gate is one bit and belongs to the platform, which can test it in the first instruction of an interrupt:
 * when the contact closes and the gate is open, the platform raises the trigger and closes the gate, in one step
 * that no second edge can split, and then tells core_sync_edge so. The core alone opens it, and only in
 * core_dispatch. There is no second copy of it that could differ.
 *
 * Why the trigger cannot rise for a sync that was not armed for: arming opens the gate inside hal->hold, after it
 * has seen there that no lock runs. So each edge comes either before (then it started a lock, and the gate stays
 * closed) or after (then it is the sync that was armed for). An edge that uses the gate has closed it before any
 * other code runs, and nothing opens it again until core_poll has said "used". Closing is a single write: an edge
 * came before it (then `used` is set, and it counts) or finds the gate closed.
 *
 * Contexts. core_sync_edge and core_light_sample may run in interrupts that do not nest; all else runs in the main
 * loop. Fields wider than a byte that both touch
 * are written by one side only while a byte tells the other to keep off:
 *   shot, sum, samples_left    interrupts, from `measuring` to `sampling` = 0; then the main loop
 *   locked_at             an edge writes it only while `locked` is 0, which the main loop claims inside hal->hold
 *   trigger_at            an edge writes it only with the gate open, when no trigger is high and `used` is 0
 *   dark                  written beside the copy in use, which `dark_now` names
 * The bytes are volatile; so is what the compiler might move past them, unless a call of the hal keeps it in place.
 * The main loop's idea of the time may be older than what an interrupt wrote since, hence passed() in core.c.
 *
 * Duties of the platform: call core_poll at least once a millisecond (it ends the trigger pulse and closes the
 * gate when its time is over), core_rx for every byte, core_sync_edge when the contact closes, core_light_sample
 * every CORE_SAMPLE_US while `sampling`, core_dark_sample every CORE_IDLE_US otherwise and once before the first
 * edge. Each ignores what the other wants. */
#ifndef UNLIT_CORE_H
#define UNLIT_CORE_H

#include "line.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    CORE_SAMPLE_US = 13,       /* one conversion of the ATmega328P's ADC at 1 MHz */
    CORE_IDLE_US = 1000,       /* between samples of the dark level */
    CORE_DARK_SHIFT = 7,       /* the dark level is the mean of a mean over 2^7 samples each */
    CORE_LOG_SIZE = 16,        /* shots that `get` still knows */
    CORE_LIGHT_THRESHOLD = 8,  /* counts above dark that are light */
    CORE_ADC_FULL = 1023,      /* a sample of this value is clipped */
    CORE_ADC_NONE = 0x7FFF,    /* no sample */
    CORE_LATE_MS = 50,         /* a fire that could not come for so long after its time is cancelled */
    CORE_TRIGGER_GAP_MS = 50,  /* no flash takes more than 20 triggers a second */
    CORE_STUCK_MS = 2000       /* a contact closed for longer is stuck */
};

struct core_hal {
    void *ctx;
    /* A line with its LF: taken whole or dropped whole, at once. Room for an answer is kept from events. */
    void (*send)(void *ctx, const char *line, uint8_t length, bool event);
    void (*trigger)(void *ctx, bool high);
    void (*gate)(void *ctx, bool open); /* a single write */
    void (*hold)(void *ctx, bool on);   /* between on and off no interrupt calls the core; some 10 us */
    /* One conversion; CORE_ADC_NONE if an edge took the converter meanwhile. */
    uint16_t (*adc)(void *ctx, uint8_t channel);
    bool (*sync_closed)(void *ctx); /* level of the contact, only to see it stuck */
    bool (*charged)(void *ctx);     /* the flash's ready output, asked only if cfg rdy=1 */
    LINE_ROM char *mcu;             /* lower case, digits */
    uint8_t adc_channels;
};

struct core_config {
    uint16_t sil_ms;   /* silence of the host after which the board goes safe */
    uint16_t pulse_us; /* length of the trigger pulse */
    uint16_t lock_ms;  /* after an edge, further ones are bounce */
    uint16_t win_us;   /* how long light is gathered after an edge; not longer than lock */
    uint16_t rec_ms;   /* recycle time of the flash */
    uint8_t rdy;       /* 1: the ready input must be high too */
};

struct core_shot {
    uint32_t n;   /* running number, from 1 */
    uint32_t tag; /* given with arm or fire; 0 for a sync that was not gated */
    uint32_t t;   /* us, when the contact closed or the trigger rose */
    int32_t e;    /* light above dark, counts summed over the window; a dark one's is the noise, of either sign */
    uint16_t pk;  /* highest sample above dark, counts */
    uint16_t b;   /* dark level, sixteenths of a count */
    uint16_t w;   /* samples that were light */
    uint16_t c;   /* samples that were clipped */
    uint16_t m;   /* samples summed */
    uint8_t bn;   /* bounces swallowed */
    bool fired;   /* src: fire command, else sync contact */
    bool gated;   /* g: the trigger was raised */
};

/* The level of darkness, and what follows from it that an interrupt must not spend its time on. */
struct core_dark {
    uint32_t level;  /* counts * 2^20 */
    uint16_t bright; /* a sample above this is light: the level in counts, and the threshold */
};

struct core {
    volatile uint8_t locked;
    volatile uint8_t measuring; /* `shot` belongs to the interrupts until core_poll reports it */
    volatile uint8_t sampling;
    volatile uint8_t used; /* the interrupt used the gate; core_poll has yet to say so */
    volatile uint8_t trigger_high;
    volatile uint8_t dark_now; /* which copy of `dark` is whole */

    const struct core_hal *hal;
    struct core_config cfg;
    uint16_t boot;
    uint8_t rst;

    /* Written by interrupts. */
    struct core_shot shot;
    volatile uint32_t locked_at, trigger_at;
    uint32_t sum;
    uint16_t samples_left;
    struct core_dark dark_then; /* as it was when the shot began */

    /* Written by the main loop, read by interrupts. */
    volatile struct core_dark dark[2];
    uint16_t samples_wanted; /* in a window; written inside hal->hold while `measuring` is 0 */
    uint32_t arm_tag;        /* while the gate is closed */

    /* Main loop only. */
    uint32_t dark_stage; /* the mean that `dark` is the mean of */
    uint8_t dark_age;    /* samples since boot, up to 255 */
    uint32_t armed_at, arm_ttl_us;
    uint32_t fire_tag, fire_from, fire_delay_us;
    uint32_t heard_at, triggered_at, closed_since, pulse_from;
    uint32_t shots;
    uint16_t events;
    bool armed, fire_pending, recycling, untold_ready, recent, greeted, strict, contact_closed, stuck_told;
    struct core_shot log[CORE_LOG_SIZE];

    char line[LINE_REQUEST_MAX + 1];
    uint8_t line_length;
    bool line_too_long;
    uint8_t last_seq; /* 0: none */
    uint16_t last_crc;
    struct line_writer out;   /* the line being written: an event, or an answer that nobody asks for again */
    struct line_writer reply; /* the last numbered one, kept for replay */
};

/* Starts the board, gate closed, and sends the boot event. boot differs from the boot before; rst is the
 * platform's word for the cause of the reset. hal must outlive the core. */
void core_init(struct core *core, const struct core_hal *hal, const struct core_config *cfg, uint16_t boot,
               uint8_t rst, uint32_t now_us);
void core_poll(struct core *core, uint32_t now_us);
void core_rx(struct core *core, uint8_t byte, uint32_t now_us);
/* The sync contact closed. gated: the gate was open; the platform has raised the trigger and closed the gate. */
void core_sync_edge(struct core *core, uint32_t now_us, bool gated);
/* One photodiode sample, counts 0..1023, between shots. */
void core_dark_sample(struct core *core, uint16_t counts);
/* And one in the window of a shot. On the AVR it has 208 cycles, with all that an interrupt costs; inline, it saves
 * only the registers that it uses. */
inline void core_light_sample(struct core *core, uint16_t counts)
{
    if (core->sampling == 0) {
        return;
    }
    core->sum += counts;
    if (counts > core->shot.pk) {
        core->shot.pk = counts;
    }
    if (counts > core->dark_then.bright) {
        core->shot.w++;
        if (counts >= CORE_ADC_FULL) {
            core->shot.c++;
        }
    }
    if (--core->samples_left == 0) {
        core->sampling = 0;
    }
}
/* sizeof(struct core), for those who cannot see it. */
size_t core_size(void);

/* Between the files of the core. */
enum line_error core_dispatch(struct core *core, struct line_request *request, uint32_t now_us,
                              struct line_writer *reply);
void core_safe(struct core *core);
/* True while the gate is open: armed, and no edge has used it. */
bool core_gate_open(const struct core *core);
/* ms until the flash may be triggered again, as far as time tells. */
uint32_t core_wait_ms(const struct core *core, uint32_t now_us);
/* Takes over the settings, unless a shot is being measured: then false, and nothing has changed. */
bool core_configure(struct core *core, const struct core_config *cfg);
bool core_charged(const struct core *core);
void core_shot_fields(struct line_writer *line, const struct core_shot *shot);

#endif
