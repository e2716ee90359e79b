/* What each request does. ../PROTOCOL.md has the table. */
#include "core.h"

#include <string.h>

#define TTL_MAX_MS UINT32_C(60000)
#define FIRE_DELAY_MAX_US UINT32_C(10000000)

static enum line_error hello(struct core *core, struct line_request *request, uint32_t now_us,
                             struct line_writer *reply)
{
    uint32_t version = 0;
    uint32_t strict = 0;
    if (!line_take(request, TEXT("v"), &version) || version != 1) {
        return LINE_ARG;
    }
    line_take(request, TEXT("strict"), &strict);
    if (strict > 1 || !line_all_taken(request)) {
        return LINE_ARG;
    }
    core_safe(core);
    core->greeted = true;
    core->strict = strict == 1;
    line_pair(reply, TEXT("v"), 1);
    line_word(reply, TEXT("fw"), TEXT("1.2"));
    line_word(reply, TEXT("mcu"), core->hal->mcu);
    line_pair(reply, TEXT("boot"), core->boot);
    line_pair(reply, TEXT("rst"), core->rst);
    line_word(reply, TEXT("caps"), TEXT("sync,fire,light"));
    line_pair(reply, TEXT("ev"), core->events);
    line_pair(reply, TEXT("n"), core->shots);
    line_pair(reply, TEXT("t"), now_us);
    return LINE_OK;
}

static enum line_error ping(struct core *core, uint32_t now_us, struct line_writer *reply)
{
    line_pair(reply, TEXT("t"), now_us);
    line_pair(reply, TEXT("g"), core_gate_open(core));
    line_pair(reply, TEXT("ev"), core->events);
    line_pair(reply, TEXT("n"), core->shots);
    return LINE_OK;
}

static enum line_error stat(struct core *core, uint32_t now_us, struct line_writer *reply)
{
    line_pair(reply, TEXT("t"), now_us);
    line_pair(reply, TEXT("g"), core_gate_open(core));
    line_pair(reply, TEXT("fire"), core->fire_pending);
    line_pair(reply, TEXT("hello"), core->greeted);
    line_pair(reply, TEXT("ready"), !core->recycling && core->locked == 0 && core_charged(core));
    line_pair(reply, TEXT("wait"), core_wait_ms(core, now_us));
    line_pair(reply, TEXT("closed"), core->contact_closed);
    line_pair(reply, TEXT("n"), core->shots);
    return LINE_OK;
}

static enum line_error setting(struct line_request *request, LINE_ROM char *key, uint32_t low, uint32_t high,
                               uint16_t *target)
{
    uint32_t value = 0;
    if (!line_take(request, key, &value)) {
        return LINE_OK;
    }
    if (value < low || value > high) {
        return LINE_ARG;
    }
    *target = (uint16_t)value;
    return LINE_OK;
}

static enum line_error cfg(struct core *core, struct line_request *request, struct line_writer *reply)
{
    struct core_config next = core->cfg;
    uint16_t rdy = next.rdy;
    const bool wrong = setting(request, TEXT("sil"), 200, 60000, &next.sil_ms) != LINE_OK ||
                       setting(request, TEXT("pulse"), 10, 20000, &next.pulse_us) != LINE_OK ||
                       setting(request, TEXT("lock"), 1, 1000, &next.lock_ms) != LINE_OK ||
                       setting(request, TEXT("win"), 100, 60000, &next.win_us) != LINE_OK ||
                       setting(request, TEXT("rec"), 0, 60000, &next.rec_ms) != LINE_OK ||
                       setting(request, TEXT("rdy"), 0, 1, &rdy) != LINE_OK;
    if (wrong || !line_all_taken(request) || next.win_us > next.lock_ms * 1000ul) {
        return LINE_ARG;
    }
    /* Times that run are not changed under way. */
    next.rdy = (uint8_t)rdy;
    if (request->count > 0 &&
        (core->armed || core->fire_pending || core->trigger_high != 0 || !core_configure(core, &next))) {
        return LINE_BUSY;
    }
    line_pair(reply, TEXT("sil"), next.sil_ms);
    line_pair(reply, TEXT("pulse"), next.pulse_us);
    line_pair(reply, TEXT("lock"), next.lock_ms);
    line_pair(reply, TEXT("win"), next.win_us);
    line_pair(reply, TEXT("rec"), next.rec_ms);
    line_pair(reply, TEXT("rdy"), next.rdy);
    return LINE_OK;
}

/* What arm and fire have in common: somebody answers for it, and the flash can take it. */
static enum line_error may_trigger(struct core *core, uint32_t now_us)
{
    if (!core->greeted) {
        return LINE_HELLO;
    }
    if (core->armed || core->fire_pending || core->contact_closed) {
        return LINE_BUSY;
    }
    if (core->recycling || core_wait_ms(core, now_us) > 0 || !core_charged(core)) {
        return LINE_NOTREADY;
    }
    return core->recent || core->trigger_high != 0 ? LINE_RATE : LINE_OK;
}

static enum line_error arm(struct core *core, struct line_request *request, uint32_t now_us)
{
    uint32_t tag = 0;
    uint32_t ttl = 0;
    if (!line_take(request, TEXT("tag"), &tag) || !line_take(request, TEXT("ttl"), &ttl) || !line_all_taken(request) ||
        tag == 0 || ttl == 0 || ttl > TTL_MAX_MS) {
        return LINE_ARG;
    }
    const enum line_error refusal = may_trigger(core, now_us);
    if (refusal != LINE_OK) {
        return refusal;
    }
    core->arm_tag = tag;
    core->armed_at = now_us;
    core->arm_ttl_us = ttl * 1000u;
    /* An edge since the question above has started a lock, and a bounce of it must not find the gate open. */
    const struct core_hal *hal = core->hal;
    hal->hold(hal->ctx, true);
    const bool free = core->locked == 0;
    if (free) {
        core->armed = true;
        hal->gate(hal->ctx, true);
    }
    hal->hold(hal->ctx, false);
    return free ? LINE_OK : LINE_NOTREADY;
}

static enum line_error fire(struct core *core, struct line_request *request, uint32_t now_us)
{
    uint32_t delay = 0;
    uint32_t tag = 0;
    line_take(request, TEXT("d"), &delay);
    line_take(request, TEXT("tag"), &tag);
    if (!line_all_taken(request) || delay > FIRE_DELAY_MAX_US) {
        return LINE_ARG;
    }
    const enum line_error refusal = may_trigger(core, now_us);
    if (refusal != LINE_OK) {
        return refusal;
    }
    core->fire_tag = tag;
    core->fire_from = now_us;
    core->fire_delay_us = delay;
    core->fire_pending = true;
    return LINE_OK;
}

static enum line_error adc(struct core *core, struct line_request *request, struct line_writer *reply)
{
    uint32_t channel = 0;
    if (!line_take(request, TEXT("ch"), &channel) || !line_all_taken(request) || channel >= core->hal->adc_channels) {
        return LINE_ARG;
    }
    const uint16_t counts = core->measuring != 0 ? CORE_ADC_NONE : core->hal->adc(core->hal->ctx, (uint8_t)channel);
    if (counts == CORE_ADC_NONE) {
        return LINE_BUSY;
    }
    line_pair(reply, TEXT("v"), counts);
    return LINE_OK;
}

static enum line_error get(struct core *core, struct line_request *request, struct line_writer *reply)
{
    uint32_t n = 0;
    if (!line_take(request, TEXT("n"), &n) || !line_all_taken(request)) {
        return LINE_ARG;
    }
    if (n == 0 || n > core->shots || core->shots - n >= CORE_LOG_SIZE) {
        return LINE_GONE;
    }
    core_shot_fields(reply, &core->log[n % CORE_LOG_SIZE]);
    return LINE_OK;
}

enum line_error core_dispatch(struct core *core, struct line_request *request, uint32_t now_us,
                              struct line_writer *reply)
{
    const char *verb = request->verb;
    if (line_is(verb, TEXT("hello"))) {
        return hello(core, request, now_us, reply);
    }
    if (line_is(verb, TEXT("cfg"))) {
        return cfg(core, request, reply);
    }
    if (line_is(verb, TEXT("arm"))) {
        return arm(core, request, now_us);
    }
    if (line_is(verb, TEXT("fire"))) {
        return fire(core, request, now_us);
    }
    if (line_is(verb, TEXT("adc"))) {
        return adc(core, request, reply);
    }
    if (line_is(verb, TEXT("get"))) {
        return get(core, request, reply);
    }
    const bool alone = request->count == 0;
    if (line_is(verb, TEXT("ping"))) {
        return alone ? ping(core, now_us, reply) : LINE_ARG;
    }
    if (line_is(verb, TEXT("stat"))) {
        return alone ? stat(core, now_us, reply) : LINE_ARG;
    }
    if (line_is(verb, TEXT("disarm"))) {
        if (!alone) {
            return LINE_ARG;
        }
        core_safe(core);
        return LINE_OK;
    }
    return LINE_VERB;
}
