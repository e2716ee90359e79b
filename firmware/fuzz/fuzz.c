/* Throws lines, edges, light and time at the core, compiled with sanitizers, and checks after every step what
 * ../PROTOCOL.md promises: `unlit-fuzz SEED FRAMES`. A frame is one line of input. The same seed gives the same run.
 *
 * Interrupts come where they can come on the board: between any two steps of the core, unless it holds them off. The
 * compiler calls the bench at the head of every basic block of core.c and verbs.c (-fsanitize-coverage=trace-pc), and
 * there an edge or a sample may come in, as in every call that the core makes of its hal. What the compiler keeps in
 * registers meanwhile stays as it was, as on the board. The bench below knows of the core only its calls and what it
 * says; where it looks inside, it says so. */
#include "core.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { FRAME_MAX = 200, BLOCKS_BETWEEN = 400 };

static struct core core;
static struct {
    uint64_t random;
    uint64_t frames, edges, fires, arms, lit_syncs, replies, errors, events, boots, nested, in_blocks, measured, late;
    uint32_t now;
    bool gate, trigger, held, in_interrupt, closed, charged, greeted, quiet;
    uint32_t blocks_left; /* until the next interrupt inside a basic block */
    /* The window of the shot that is measured: what it may take, and what it took. */
    uint32_t wanted, taken, sum;
    bool fire_due; /* an accepted fire that nothing has cancelled */
    uint32_t fire_from, fire_delay;
    uint32_t told_now; /* the time that the core was given last */
    uint32_t rose_at, shot_at, armed_at, armed_ttl, life_at;
    uint32_t junk; /* frames to come from a host that has lost its mind */
    bool ever_rose, seen_high;
    uint32_t seen_high_at;
    uint16_t last_event;
    uint32_t shots_begun, shots_told;
    char frame[FRAME_MAX + 1]; /* the line in hand, NUL at its end */
    char verb[16];
    bool replay;
    unsigned answers;
    char answer[LINE_TEXT_MAX + 1];
    unsigned last_seq;
    char last_request[FRAME_MAX + 1];
} bench;

static void fail(const char *what)
{
    fprintf(stderr, "frame %llu: %s\nline: %s\nanswer: %s\n", (unsigned long long)bench.frames, what, bench.frame,
            bench.answer);
    abort();
}

static void must(bool holds, const char *what)
{
    if (!holds) {
        fail(what);
    }
}

/* xorshift64*. */
static uint32_t below(uint32_t limit)
{
    uint64_t x = bench.random;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    bench.random = x;
    return (uint32_t)((x * UINT64_C(0x2545F4914F6CDD1D)) >> 33) % limit;
}

static unsigned crc16(const char *text, size_t length)
{
    unsigned crc = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        crc ^= (unsigned)(unsigned char)text[i] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) != 0 ? (crc << 1 ^ 0x1021u) & 0xFFFFu : crc << 1;
        }
    }
    return crc;
}

/* ---- the platform ---- */

static void rise(void)
{
    must(!bench.ever_rose || bench.now - bench.rose_at >= CORE_TRIGGER_GAP_MS * 1000u, "two triggers within 50 ms");
    bench.trigger = true;
    bench.seen_high = false;
    bench.rose_at = bench.now;
    bench.ever_rose = true;
}

static void note_shot(void)
{
    bench.shots_begun++;
    bench.shot_at = bench.now;
    bench.wanted = core.cfg.win_us / CORE_SAMPLE_US; /* inside: the setting in force */
    bench.taken = bench.sum = 0;
}

static void light(void)
{
    const uint16_t counts = (uint16_t)below(CORE_ADC_FULL + 1);
    const bool outer = bench.in_interrupt;
    bench.in_interrupt = true; /* they do not nest */
    if (core.sampling != 0) {  /* inside: the board asks, too */
        bench.taken++;
        bench.sum += counts;
    }
    core_light_sample(&core, counts);
    bench.in_interrupt = outer;
}

static void edge(void)
{
    const bool outer = bench.in_interrupt;
    bench.in_interrupt = true;
    const bool gated = bench.gate;
    const bool begins = gated || core.locked == 0; /* inside: what is bounce */
    bench.edges++;
    if (gated) {
        must(bench.greeted, "a sync triggered before hello");
        must(core.locked == 0 && core.measuring == 0, "a bounce found the gate open");
        rise();
        bench.gate = false;
        bench.lit_syncs++;
    }
    core_sync_edge(&core, bench.now, gated);
    if (begins) {
        note_shot();
    }
    bench.in_interrupt = outer;
}

static bool interruptible(void)
{
    return !bench.held && !bench.in_interrupt && !bench.quiet;
}

static void interrupt(void)
{
    bench.nested++;
    /* Later than what the main loop took for now; the bench's own time goes on with it. */
    bench.now += below(60);
    if (below(3) != 0) {
        edge();
    } else {
        light();
    }
}

static void maybe_interrupt(void)
{
    if (interruptible() && below(24) == 0) {
        interrupt();
    }
}

void __sanitizer_cov_trace_pc(void);
void __sanitizer_cov_trace_pc(void)
{
    if (interruptible() && bench.blocks_left-- == 0) {
        bench.blocks_left = below(2 * BLOCKS_BETWEEN);
        bench.in_blocks++;
        interrupt();
    }
}

static int32_t number_after(const char *line, const char *key)
{
    const char *at = strstr(line, key);
    must(at != NULL, "a shot without one of its fields");
    return (int32_t)strtol(at + strlen(key), NULL, 10);
}

/* A shot's window and energy, counted apart from the core. `b` is rounded to sixteenths, and so is what it adds up to. */
static void judge_shot(const char *line)
{
    const int32_t m = number_after(line, " m="), e = number_after(line, " e="), b = number_after(line, " b=");
    must(bench.now - bench.shot_at >= core.cfg.lock_ms * 1000u, "a shot told before its lock was over");
    must(m == (int32_t)bench.taken && bench.taken <= bench.wanted, "a window of other samples than it took");
    const int32_t dark = (int32_t)bench.sum - e;
    must(abs(dark - m * b / 16) <= m / 32 + 2, "an energy that is not the light above dark");
    bench.measured += m > 0;
}

static uint32_t since_fire(void)
{
    return bench.told_now - bench.fire_from;
}

static void hal_send(void *ctx, const char *line, uint8_t length, bool event)
{
    (void)ctx;
    must(length >= 7 && length < LINE_TEXT_MAX, "a line too short or cut off");
    must(line[length - 1] == '\n', "a line without its end");
    must(line[length - 6] == '*', "a line without checksum");
    char crc[5];
    snprintf(crc, sizeof crc, "%04X", crc16(line, length - 6u));
    must(memcmp(crc, line + length - 5, 4) == 0, "a wrong checksum");
    for (uint8_t i = 0; i + 1 < length; i++) {
        must(line[i] >= ' ' && line[i] <= '~', "an unprintable byte was sent");
    }
    must(event == (line[0] == '!') && (event || line[0] == '#'), "neither event nor answer");
    if (event) {
        const unsigned number = (unsigned)strtoul(line + 1, NULL, 10);
        must(number == (uint16_t)(bench.last_event + 1), "a gap in the numbers of events");
        bench.last_event = (uint16_t)number;
        bench.events++;
        if (strstr(line, " shot n=") != NULL) {
            bench.shots_told++;
            judge_shot(line);
        }
        /* A delayed fire is cancelled by silence and by being late, which say so. */
        const char *said = strchr(line, ' ');
        if (strncmp(said, " disarm why=late", 16) == 0) {
            must(bench.fire_due && since_fire() >= bench.fire_delay + CORE_LATE_MS * 1000u, "a fire cancelled early");
            bench.fire_due = false;
            bench.late++;
        } else if (strncmp(said, " disarm why=silence", 19) == 0) {
            bench.fire_due = false;
        }
    } else {
        bench.answers++;
        memcpy(bench.answer, line, length);
        bench.answer[length - 1] = '\0';
        bench.replies++;
    }
    maybe_interrupt();
}

static void hal_trigger(void *ctx, bool high)
{
    (void)ctx;
    if (high) {
        must(bench.held && bench.fire_due && bench.greeted, "a trigger that nobody asked for");
        must(core.cfg.rdy == 0 || bench.charged, "fired a flash that is not charged"); /* inside: whether it is asked */
        must(since_fire() >= bench.fire_delay, "a fire before its time");
        must(since_fire() < bench.fire_delay + CORE_LATE_MS * 1000u, "a fire long after its time");
        rise();
        bench.fire_due = false;
        bench.fires++;
        note_shot();
    } else {
        must(!bench.trigger || bench.now - bench.rose_at >= core.cfg.pulse_us, "a pulse cut short");
        bench.trigger = false;
        maybe_interrupt();
    }
}

static void hal_gate(void *ctx, bool open)
{
    (void)ctx;
    if (open) {
        must(bench.held, "the gate opened where an edge may come between");
        must(strcmp(bench.verb, "arm") == 0 && !bench.replay, "the gate opened without arm");
        must(bench.greeted, "the gate opened before hello");
        bench.arms++;
    }
    bench.gate = open;
    if (!bench.held) {
        maybe_interrupt();
    }
}

static void hal_hold(void *ctx, bool on)
{
    (void)ctx;
    must(bench.held != on, "hold within hold");
    if (on) {
        maybe_interrupt();
    }
    bench.held = on;
    if (!on) {
        maybe_interrupt();
    }
}

static uint16_t hal_adc(void *ctx, uint8_t channel)
{
    (void)ctx;
    must(channel < 2, "a channel that is not there");
    maybe_interrupt();
    return (uint16_t)(below(8) == 0 ? CORE_ADC_NONE : (int)below(1024));
}

static bool hal_sync_closed(void *ctx)
{
    (void)ctx;
    maybe_interrupt();
    return bench.closed;
}

static bool hal_charged(void *ctx)
{
    (void)ctx;
    maybe_interrupt();
    return bench.charged;
}

static const struct core_hal hal = { .send = hal_send, .trigger = hal_trigger, .gate = hal_gate, .hold = hal_hold,
                                     .adc = hal_adc, .sync_closed = hal_sync_closed, .charged = hal_charged,
                                     .mcu = "fuzz", .adc_channels = 2 };

static void boot(void)
{
    static const struct core_config cfg = { 1500, 1000, 30, 20000, 150, 0 };
    bench.boots++;
    bench.gate = bench.trigger = bench.greeted = bench.fire_due = bench.ever_rose = false;
    bench.last_event = 0;
    bench.shots_begun = bench.shots_told = 0;
    bench.last_seq = 0;
    bench.life_at = bench.now;
    bench.quiet = true; /* edges come only once the board has started */
    memset(&core, 0xA5, sizeof core);
    core_init(&core, &hal, &cfg, (uint16_t)bench.boots, (uint8_t)below(256), bench.now);
    core_dark_sample(&core, (uint16_t)below(40));
    bench.quiet = false;
}

/* ---- what must hold after every step ---- */

static void poll_and_check(void)
{
    const uint32_t now = bench.now;
    if (!bench.trigger) {
        bench.seen_high = false;
    } else if (!bench.seen_high) {
        bench.seen_high = true;
        bench.seen_high_at = now;
    }
    bench.told_now = now;
    core_poll(&core, now);
    bench.quiet = true; /* the questions themselves must not be overtaken */
    if (bench.trigger && bench.seen_high) {
        must(now - bench.seen_high_at < core.cfg.pulse_us, "the trigger stayed up");
    }
    if (bench.gate) {
        must(now - bench.armed_at < bench.armed_ttl || now - bench.armed_at > UINT32_C(0x80000000),
             "the gate outlived its time");
        must(now - bench.life_at < core.cfg.sil_ms * 1000ul, "the gate outlived the host");
        must(core_gate_open(&core), "the gate is open and the core does not know");
    }
    must(!bench.fire_due || now - bench.life_at < core.cfg.sil_ms * 1000ul, "a delayed fire outlived the host");
    must(!bench.held, "interrupts held off for good");
    must(bench.shots_begun == bench.shots_told + (core.measuring != 0), "a sync without its shot, or two");
    bench.quiet = false;
}

/* ---- lines ---- */

static void note_frame(void)
{
    const char *star = strchr(bench.frame, '*');
    const size_t length = strlen(bench.frame);
    const char *body = bench.frame;
    unsigned seq = 0, crc = 0;
    if (*body == '#') {
        seq = (unsigned)strtoul(body + 1, NULL, 10);
        body = strchr(body, ' ') != NULL ? strchr(body, ' ') + 1 : body + 1;
    }
    if (sscanf(body, "%15[a-z]", bench.verb) != 1) {
        bench.verb[0] = '\0';
    }
    const bool sealed = star != NULL && length - (size_t)(star - bench.frame) == 5 &&
                        sscanf(star + 1, "%4X", &crc) == 1 && crc == crc16(bench.frame, (size_t)(star - bench.frame));
    const bool numbered = sealed && seq >= 1 && seq <= 255 && bench.frame[0] == '#';
    bench.replay = numbered && seq == bench.last_seq && strcmp(bench.verb, "hello") != 0;
    bench.answers = 0;
    bench.answer[0] = '\0';
}

static void judge_frame(size_t length)
{
    must(bench.answers == (length > 0 ? 1u : 0u), "not one answer to one request");
    if (bench.answers == 0) {
        return;
    }
    unsigned seq = 0, code = 0;
    const bool refused = sscanf(bench.answer, "#%u err %u", &seq, &code) == 2;
    must(refused || sscanf(bench.answer, "#%u", &seq) == 1, "an answer without number");
    bench.errors += refused;
    /* Un-numbered lines that could not be read or are refused as such are no life; all else may be. */
    const bool dead = seq == 0 && refused && (code <= LINE_LONG || code == LINE_HELLO);
    bench.life_at = dead ? bench.life_at : bench.now;
    if (seq != 0) {
        must(bench.replay || bench.last_seq != seq || strcmp(bench.verb, "hello") == 0, "a number used twice");
        bench.last_seq = bench.replay ? bench.last_seq : seq;
    }
    if (refused || bench.replay) {
        return;
    }
    if (strcmp(bench.verb, "hello") == 0) {
        bench.greeted = true;
    }
    if (strcmp(bench.verb, "hello") == 0 || strcmp(bench.verb, "disarm") == 0) {
        must(!bench.gate, "the gate is open after hello or disarm");
        bench.fire_due = false;
    }
    if (strcmp(bench.verb, "fire") == 0) {
        const char *delay = strstr(bench.frame, " d=");
        bench.fire_due = true;
        bench.fire_from = bench.told_now;
        bench.fire_delay = delay != NULL ? (uint32_t)strtoul(delay + 3, NULL, 10) : 0;
    }
}

/* A line's bytes into the core. whole: it has no LF of its own inside. */
static void feed(const char *bytes, size_t length)
{
    const bool whole = memchr(bytes, '\n', length) == NULL;
    size_t kept = 0;
    for (size_t i = 0; i < length; i++) {
        if (bytes[i] != '\r' && kept < FRAME_MAX) {
            bench.frame[kept++] = bytes[i];
        }
    }
    bench.frame[kept] = '\0';
    const bool plain = memchr(bytes, '\0', length) == NULL;
    if (whole) {
        note_frame();
        const char *ttl = strstr(bench.frame, "ttl=");
        if (!bench.gate) {
            bench.armed_ttl = ttl != NULL ? (uint32_t)strtoul(ttl + 4, NULL, 10) * 1000u : 0;
        }
    } else {
        bench.verb[0] = '\0';
        bench.replay = false;
    }
    for (size_t i = 0; i < length; i++) {
        bench.told_now = bench.now;
        core_rx(&core, (uint8_t)bytes[i], bench.told_now);
    }
    if (!bench.gate) {
        bench.armed_at = bench.now;
    }
    bench.told_now = bench.now;
    core_rx(&core, '\n', bench.told_now);
    bench.frames++;
    if (whole && plain) {
        judge_frame(kept);
    } else if (bench.answers > 0) {
        bench.life_at = bench.now;
    }
}

static size_t write_request(char *text, size_t room)
{
    static const char *const keys[] = { "sil", "pulse", "lock", "win", "rec", "rdy" };
    char body[96];
    switch (below(16)) {
    case 0:
    case 1: snprintf(body, sizeof body, "hello v=1 strict=%u", below(4) == 0); break;
    case 2: snprintf(body, sizeof body, "ping"); break;
    case 3: snprintf(body, sizeof body, "stat"); break;
    case 4:
        snprintf(body, sizeof body, "cfg %s=%u", keys[below(6)], below(3) == 0 ? below(70000) : 100 + below(2000));
        break;
    case 5: snprintf(body, sizeof body, "cfg rec=%u sil=1500 lock=30 win=20000 rdy=%u", below(100), below(8) == 0); break;
    case 6: snprintf(body, sizeof body, "disarm"); break;
    case 7:
    case 8: snprintf(body, sizeof body, "fire d=%u tag=%u", below(3) == 0 ? 0 : below(200000), below(100)); break;
    case 9: snprintf(body, sizeof body, "adc ch=%u", below(3)); break;
    case 15: snprintf(body, sizeof body, "cfg sil=1 pulse=2 lock=3 win=4 rec=5 rdy=6 x=%u y=8", below(9)); break;
    case 10: snprintf(body, sizeof body, "get n=%u", bench.shots_told + 2 - below(20)); break;
    case 11: snprintf(body, sizeof body, "arm tag=%u ttl=%u x=1", below(3), below(61000)); break;
    default: snprintf(body, sizeof body, "arm tag=%u ttl=%u", 1 + below(1000), 1 + below(3000)); break;
    }
    int length = 0;
    if (below(8) == 0) {
        return (size_t)snprintf(text, room, "%s", body);
    }
    const unsigned seq = below(10) == 0 ? below(300) : bench.last_seq % 255 + 1;
    length = snprintf(text, room, "#%u %s", seq, body);
    return (size_t)(length + snprintf(text + length, room - (size_t)length, "*%04X", crc16(text, (size_t)length)));
}

static void one_frame(void)
{
    char text[FRAME_MAX];
    size_t length = 0;
    const uint32_t kind = below(20);
    if (bench.junk > 0) {
        bench.junk--;
        length = (size_t)snprintf(text, sizeof text, "%s", below(2) == 0 ? "ping" : "#9 ping*0000");
    } else if (kind == 0) {
        length = below(130);
        for (size_t i = 0; i < length; i++) {
            text[i] = (char)below(256);
        }
    } else if (kind == 1 && bench.last_request[0] != '\0') {
        length = (size_t)snprintf(text, sizeof text, "%s", bench.last_request);
    } else {
        length = write_request(text, sizeof text);
        snprintf(bench.last_request, sizeof bench.last_request, "%s", text);
        if (kind < 5) { /* damaged */
            const size_t at = below((uint32_t)length);
            switch (below(4)) {
            case 0: text[at] = (char)(text[at] ^ (char)(1u << below(8))); break;
            case 1: length = at; break;
            case 2: memmove(text + at, text + at + 1, length - at - 1), length--; break;
            default: memmove(text + at + 1, text + at, length - at), length++; break;
            }
        }
    }
    feed(text, length);
}

static void some_time(void)
{
    switch (below(8)) {
    case 0: bench.now += below(20); break;
    case 1:
    case 2:
    case 3: bench.now += below(2000); break;
    case 4:
    case 5: bench.now += 20000 + below(60000); break;
    case 6: bench.now += below(300000); break;
    default: bench.now += below(8) != 0 ? below(1000) : below(8) != 0 ? below(4000000) : below(70000000); break;
    }
}

static void step(void)
{
    one_frame();
    const uint32_t more = below(4);
    for (uint32_t i = 0; i < more; i++) {
        switch (below(8)) {
        case 0:
        case 1: edge(); break;
        case 2:
            for (uint32_t samples = below(60); samples > 0; samples--) {
                light();
            }
            break;
        case 3: core_dark_sample(&core, (uint16_t)below(1024)); break;
        case 4: bench.closed = below(4) == 0; break;
        case 5: bench.charged = below(4) != 0; break;
        default: some_time(); break;
        }
        poll_and_check();
    }
    if (below(200) == 0) {
        bench.junk = below(60);
    }
    if (below(2000) == 0) {
        boot();
    }
}

int main(int count, char **arguments)
{
    if (count != 3) {
        fprintf(stderr, "usage: unlit-fuzz SEED FRAMES\n");
        return 2;
    }
    const uint64_t frames = strtoull(arguments[2], NULL, 10);
    bench.random = (strtoull(arguments[1], NULL, 10) + 1) * UINT64_C(0x9E3779B97F4A7C15);
    bench.now = UINT32_MAX - 500000; /* the clock wraps at once, and again every 71 minutes */
    bench.charged = true;
    const clock_t begun = clock();
    boot();
    while (bench.frames < frames) {
        step();
    }
    printf("%llu frames in %.1f s: %llu answers (%llu refusals), %llu events, %llu edges, %llu interrupts inside the core "
           "(%llu between two blocks), %llu windows measured, "
           "%llu arms, %llu syncs let through, %llu fires, %llu too late, %llu boots\n",
           (unsigned long long)bench.frames, (double)(clock() - begun) / CLOCKS_PER_SEC,
           (unsigned long long)bench.replies, (unsigned long long)bench.errors, (unsigned long long)bench.events,
           (unsigned long long)bench.edges, (unsigned long long)bench.nested, (unsigned long long)bench.in_blocks,
           (unsigned long long)bench.measured, (unsigned long long)bench.arms,
           (unsigned long long)bench.lit_syncs, (unsigned long long)bench.fires, (unsigned long long)bench.late,
           (unsigned long long)bench.boots);
    return 0;
}
