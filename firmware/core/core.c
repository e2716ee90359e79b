#include "core.h"

#include <string.h>

/* Values of trigger_high; 0 is low. */
enum { RISEN = 1, TIMED = 2 };

/* One count of a dark level: the fraction keeps 2^20 parts, so that a window's sum of it is right to a count. */
#define DARK_ONE (UINT32_C(1) << 20)

/* us since then_us. An interrupt may note a moment that lies after now_us, which the main loop took earlier; that
 * is 0, not nearly 2^32. Right as long as it is asked within 2^31 us of then. */
static uint32_t elapsed(uint32_t now_us, uint32_t then_us)
{
    const uint32_t gone = now_us - then_us;
    return gone < UINT32_C(0x80000000) ? gone : 0;
}

/* True once span_us have passed since then_us. */
static bool passed(uint32_t now_us, uint32_t then_us, uint32_t span_us)
{
    return elapsed(now_us, then_us) >= span_us;
}

static void answer_with(struct core *core, const struct line_writer *line)
{
    core->hal->send(core->hal->ctx, line->text, line->length, false);
}

static struct line_writer *start_event(struct core *core, LINE_ROM char *name)
{
    struct line_writer *line = &core->out;
    core->events++;
    line_start(line);
    line_text(line, TEXT("!"));
    line_uint(line, core->events);
    line_text(line, TEXT(" "));
    line_text(line, name);
    return line;
}

static void send_event(struct core *core)
{
    line_seal(&core->out);
    core->hal->send(core->hal->ctx, core->out.text, core->out.length, true);
}

static void tell_disarm(struct core *core, LINE_ROM char *why)
{
    struct line_writer *line = start_event(core, TEXT("disarm"));
    line_word(line, TEXT("why"), why);
    send_event(core);
}

void core_init(struct core *core, const struct core_hal *hal, const struct core_config *cfg, uint16_t boot,
               uint8_t rst, uint32_t now_us)
{
    memset(core, 0, sizeof *core);
    core->hal = hal;
    core_configure(core, cfg);
    core->boot = boot;
    core->rst = rst;
    core->heard_at = now_us;
    hal->gate(hal->ctx, false);
    hal->trigger(hal->ctx, false);
    struct line_writer *line = start_event(core, TEXT("boot"));
    line_pair(line, TEXT("boot"), boot);
    line_pair(line, TEXT("rst"), rst);
    send_event(core);
}

bool core_configure(struct core *core, const struct core_config *cfg)
{
    const uint16_t samples = (uint16_t)(cfg->win_us / CORE_SAMPLE_US); /* a division is too long to hold for */
    /* An edge comes before, and its shot keeps its settings, or after, and has the new ones. */
    const struct core_hal *hal = core->hal;
    hal->hold(hal->ctx, true);
    const bool free = core->measuring == 0;
    if (free) {
        core->cfg = *cfg;
        core->samples_wanted = samples;
    }
    hal->hold(hal->ctx, false);
    return free;
}

size_t core_size(void)
{
    return sizeof(struct core);
}

/* ---- light and edges: interrupts ---- */

/* Opens a shot. `measuring` is set before `sampling`, and both last, so that the other side never sees half. */
static void begin_shot(struct core *core, uint32_t now_us, bool fired, bool gated, uint32_t tag)
{
    struct core_shot *shot = &core->shot;
    shot->tag = tag;
    shot->t = now_us;
    shot->pk = shot->w = shot->c = 0;
    shot->bn = 0;
    shot->fired = fired;
    shot->gated = gated;
    const volatile struct core_dark *dark = &core->dark[core->dark_now];
    core->dark_then.level = dark->level;
    core->dark_then.bright = dark->bright;
    core->sum = 0;
    core->samples_left = core->samples_wanted;
    core->locked_at = now_us;
    core->locked = 1;
    core->measuring = 1;
    core->sampling = 1;
}

static void note_rise(struct core *core, uint32_t now_us)
{
    core->trigger_at = now_us;
    core->trigger_high = RISEN;
}

void core_sync_edge(struct core *core, uint32_t now_us, bool gated)
{
    if (gated) {
        note_rise(core, now_us);
        core->used = 1;
        begin_shot(core, now_us, false, true, core->arm_tag);
    } else if (core->locked == 0) {
        begin_shot(core, now_us, false, false, 0);
    } else if (core->measuring != 0 && core->shot.bn < UINT8_MAX) {
        core->shot.bn++;
    }
}

/* Two running means in a row, each over 2^shift samples: as steady as one over twice as many, but a ripple of the
 * mains is damped by the square. After boot the shift grows with the number of samples there are. */
void core_dark_sample(struct core *core, uint16_t counts)
{
    /* The tail of a pulse is not darkness, so the dark level rests until the lock is over. */
    if (core->locked != 0) {
        return;
    }
    const uint32_t sample = (uint32_t)counts * DARK_ONE;
    uint8_t shift = 0;
    while (shift < CORE_DARK_SHIFT && (core->dark_age >> (shift + 1)) != 0) {
        shift++;
    }
    if (core->dark_age < UINT8_MAX) {
        core->dark_age++;
    }
    uint32_t level = core->dark[core->dark_now].level;
    core->dark_stage = core->dark_stage - (core->dark_stage >> shift) + (sample >> shift);
    level = level - (level >> shift) + (core->dark_stage >> shift);
    const uint8_t other = core->dark_now ^ 1u;
    core->dark[other].level = level;
    core->dark[other].bright = (uint16_t)((level + DARK_ONE / 2u) / DARK_ONE + CORE_LIGHT_THRESHOLD);
    core->dark_now = other;
}

extern inline void core_light_sample(struct core *core, uint16_t counts);

/* ---- main loop ---- */

void core_shot_fields(struct line_writer *line, const struct core_shot *shot)
{
    line_pair(line, TEXT("n"), shot->n);
    line_word(line, TEXT("src"), shot->fired ? TEXT("fire") : TEXT("sync"));
    line_pair(line, TEXT("g"), shot->gated ? 1 : 0);
    line_pair(line, TEXT("tag"), shot->tag);
    line_pair(line, TEXT("t"), shot->t);
    line_signed(line, TEXT("e"), shot->e);
    line_pair(line, TEXT("pk"), shot->pk);
    line_pair(line, TEXT("b"), shot->b);
    line_pair(line, TEXT("w"), shot->w);
    line_pair(line, TEXT("c"), shot->c);
    line_pair(line, TEXT("m"), shot->m);
    line_pair(line, TEXT("bn"), shot->bn);
}

/* What `samples` samples (at most 60000 us / CORE_SAMPLE_US of them) of the dark level add up to, in counts. Whole
 * counts and 4096ths apart, because their product with the full fraction would not fit 32 bits. */
static uint32_t dark_sum(uint16_t samples, uint32_t dark)
{
    const uint32_t whole = dark / DARK_ONE;
    const uint32_t parts = (dark % DARK_ONE + DARK_ONE / 8192u) / (DARK_ONE / 4096u);
    return samples * whole + (samples * parts + 2048u) / 4096u;
}

static void report_shot(struct core *core)
{
    core->hal->hold(core->hal->ctx, true);
    core->sampling = 0;
    core->hal->hold(core->hal->ctx, false);
    struct core_shot *shot = &core->shot;
    shot->m = (uint16_t)(core->samples_wanted - core->samples_left);
    shot->e = (int32_t)(core->sum - dark_sum(shot->m, core->dark_then.level));
    const uint16_t dark = (uint16_t)(core->dark_then.bright - CORE_LIGHT_THRESHOLD);
    shot->pk = shot->pk > dark ? (uint16_t)(shot->pk - dark) : 0;
    shot->b = (uint16_t)((core->dark_then.level + DARK_ONE / 32u) / (DARK_ONE / 16u));
    shot->n = ++core->shots;
    core->log[shot->n % CORE_LOG_SIZE] = *shot;
    core->measuring = 0;

    struct line_writer *line = start_event(core, TEXT("shot"));
    core_shot_fields(line, &core->log[core->shots % CORE_LOG_SIZE]);
    send_event(core);
}

bool core_charged(const struct core *core)
{
    return core->cfg.rdy == 0 || core->hal->charged(core->hal->ctx);
}

uint32_t core_wait_ms(const struct core *core, uint32_t now_us)
{
    uint32_t wait_us = 0;
    if (core->recycling) {
        const uint32_t span = (uint32_t)core->cfg.rec_ms * 1000u;
        const uint32_t gone = elapsed(now_us, core->triggered_at);
        wait_us = gone < span ? span - gone : 0;
    }
    if (core->locked != 0) {
        const uint32_t span = (uint32_t)core->cfg.lock_ms * 1000u;
        const uint32_t gone = elapsed(now_us, core->locked_at);
        const uint32_t lock_us = gone < span ? span - gone : 1;
        wait_us = lock_us > wait_us ? lock_us : wait_us;
    }
    return (wait_us + 999u) / 1000u;
}

bool core_gate_open(const struct core *core)
{
    return core->armed && core->used == 0;
}

/* Closes the gate and forgets a delayed fire. Whatever the interrupt did before the gate closed stands. */
void core_safe(struct core *core)
{
    core->hal->gate(core->hal->ctx, false);
    core->fire_pending = false;
    if (core->used == 0) {
        core->armed = false;
    }
}

static void note_trigger(struct core *core, uint32_t at_us)
{
    core->triggered_at = at_us;
    core->recycling = core->untold_ready = true;
    core->recent = true;
}

static void fire_now(struct core *core, uint32_t now_us)
{
    const struct core_hal *hal = core->hal;
    hal->hold(hal->ctx, true);
    /* An edge may have come first; then the fire waits its turn. From here on an edge is a bounce of this shot. */
    if (core->locked == 0) {
        hal->trigger(hal->ctx, true);
        note_rise(core, now_us);
        begin_shot(core, now_us, true, true, core->fire_tag);
        core->fire_pending = false;
        note_trigger(core, now_us);
    }
    hal->hold(hal->ctx, false);
}

static void watch_contact(struct core *core, uint32_t now_us)
{
    if (!core->hal->sync_closed(core->hal->ctx)) {
        core->contact_closed = core->stuck_told = false;
        return;
    }
    if (!core->contact_closed) {
        core->contact_closed = true;
        core->closed_since = now_us;
    }
    if (!core->stuck_told && passed(now_us, core->closed_since, CORE_STUCK_MS * 1000ul)) {
        core->stuck_told = true;
        start_event(core, TEXT("stuck"));
        send_event(core);
    }
}

/* A shot is reported when its lock time is over; the lock itself goes on while the contact stays closed,
 * because it bounces when it opens, too. It never ends before the shot is told: now_us may be older than the shot, and
 * with it locked_at. */
static void end_lock(struct core *core, uint32_t now_us)
{
    const uint32_t lock_us = (uint32_t)core->cfg.lock_ms * 1000u;
    if (core->measuring != 0 && passed(now_us, *(const volatile uint32_t *)&core->shot.t, lock_us)) {
        report_shot(core);
    }
    if (core->locked == 0) {
        return;
    }
    if (core->contact_closed) {
        core->locked_at = now_us;
    } else if (core->measuring == 0 && passed(now_us, core->locked_at, lock_us)) {
        core->locked = 0;
    }
}

/* Counts from the poll after the rise, unless that was noted later than this poll's time: a pulse may be too long by
 * a poll, but never too short. A platform that ends it by itself is before this. */
static void end_pulse(struct core *core, uint32_t now_us)
{
    if (core->trigger_high == RISEN) {
        core->pulse_from = elapsed(now_us, core->trigger_at) > 0 ? now_us : core->trigger_at;
        core->trigger_high = TIMED;
    } else if (core->trigger_high == TIMED && passed(now_us, core->pulse_from, core->cfg.pulse_us)) {
        core->hal->trigger(core->hal->ctx, false);
        core->trigger_high = 0;
    }
}

void core_poll(struct core *core, uint32_t now_us)
{
    end_pulse(core, now_us);
    LINE_ROM char *why = NULL;
    if ((core->armed || core->fire_pending) && passed(now_us, core->heard_at, core->cfg.sil_ms * 1000ul)) {
        why = TEXT("silence");
    } else if (core->armed && passed(now_us, core->armed_at, core->arm_ttl_us)) {
        why = TEXT("ttl");
    } else if (core->fire_pending && passed(now_us, core->fire_from, core->fire_delay_us + CORE_LATE_MS * 1000ul)) {
        why = TEXT("late");
    }
    if (why != NULL) {
        core_safe(core);
    }
    /* Before anything is written, which takes milliseconds: now_us must still be true. */
    if (core->fire_pending && passed(now_us, core->fire_from, core->fire_delay_us) && core->locked == 0 &&
        core_charged(core)) {
        fire_now(core, now_us);
    }
    /* The interrupt may have used the gate just before it was closed; then that is what happened. */
    if (why != NULL && core->used == 0) {
        tell_disarm(core, why);
    }
    if (core->used != 0) {
        core->used = 0;
        core->armed = false;
        note_trigger(core, core->trigger_at);
        tell_disarm(core, TEXT("used"));
    }
    watch_contact(core, now_us);
    end_lock(core, now_us);
    if (core->recent && passed(now_us, core->triggered_at, CORE_TRIGGER_GAP_MS * 1000ul)) {
        core->recent = false;
    }
    if (core->recycling && passed(now_us, core->triggered_at, core->cfg.rec_ms * 1000ul)) {
        core->recycling = false;
    }
    if (core->untold_ready && !core->recycling && core_charged(core)) {
        core->untold_ready = false;
        start_event(core, TEXT("ready"));
        send_event(core);
    }
}

/* ---- requests ---- */

static LINE_ROM char *error_word(enum line_error error, bool greeted)
{
    switch (error) {
    case LINE_CRC: return TEXT("crc");
    case LINE_SYNTAX: return TEXT("syntax");
    case LINE_LONG: return TEXT("long");
    case LINE_VERB: return TEXT("verb");
    case LINE_ARG: return TEXT("arg");
    case LINE_SEQ: return TEXT("seq");
    case LINE_HELLO: return greeted ? TEXT("strict") : TEXT("hello");
    case LINE_NOTREADY: return TEXT("notready");
    case LINE_BUSY: return TEXT("busy");
    case LINE_RATE: return TEXT("rate");
    case LINE_GONE: return TEXT("gone");
    case LINE_OK: break;
    }
    return TEXT("ok");
}

static void start_reply(struct line_writer *line, uint8_t seq)
{
    line_start(line);
    line_text(line, TEXT("#"));
    line_uint(line, seq);
}

static void refuse(struct line_writer *line, uint8_t seq, enum line_error error, bool greeted)
{
    start_reply(line, seq);
    line_text(line, TEXT(" err "));
    line_uint(line, error);
    line_text(line, TEXT(" "));
    line_text(line, error_word(error, greeted));
    line_seal(line);
}

static void answer(struct core *core, struct line_request *request, uint32_t now_us, struct line_writer *line)
{
    start_reply(line, request->seq);
    line_text(line, TEXT(" ok"));
    const enum line_error error = core_dispatch(core, request, now_us, line);
    if (error == LINE_OK) {
        line_seal(line);
    } else {
        refuse(line, request->seq, error, core->greeted);
    }
}

static void take_line(struct core *core, uint32_t now_us)
{
    struct line_request request;
    const enum line_error error = line_parse(core->line, core->line_length, &request);
    struct line_writer *line = &core->out;
    if (error != LINE_OK && request.seq == 0) {
        refuse(line, 0, error, core->greeted);
        answer_with(core, line);
        return;
    }
    if (request.seq == 0) {
        if (core->strict) {
            refuse(line, 0, LINE_HELLO, true);
        } else {
            core->heard_at = now_us;
            answer(core, &request, now_us, line);
        }
        answer_with(core, line);
        return;
    }
    core->heard_at = now_us;
    /* hello starts a conversation and changes nothing when repeated, so it is carried out every time: a new
     * host must never get the answer that its predecessor had, nor leave the gate as he left it. */
    const bool hello = error == LINE_OK && line_is(request.verb, TEXT("hello"));
    if (request.seq == core->last_seq && !hello) {
        if (request.crc == core->last_crc) {
            answer_with(core, &core->reply);
        } else {
            refuse(line, request.seq, LINE_SEQ, core->greeted);
            answer_with(core, line);
        }
        return;
    }
    core->last_seq = request.seq;
    core->last_crc = request.crc;
    if (error == LINE_OK) {
        answer(core, &request, now_us, &core->reply);
    } else {
        refuse(&core->reply, request.seq, error, core->greeted);
    }
    answer_with(core, &core->reply);
}

void core_rx(struct core *core, uint8_t byte, uint32_t now_us)
{
    if (byte == '\r') {
        return;
    }
    if (byte != '\n') {
        if (core->line_length < LINE_REQUEST_MAX) {
            core->line[core->line_length++] = (char)byte;
        } else {
            core->line_too_long = true;
        }
        return;
    }
    core_poll(core, now_us); /* so that no request meets a gate whose time is over */
    if (core->line_too_long) {
        struct line_writer *line = &core->out;
        refuse(line, 0, LINE_LONG, core->greeted);
        answer_with(core, line);
    } else if (core->line_length > 0) {
        take_line(core, now_us);
    }
    core->line_length = 0;
    core->line_too_long = false;
}
