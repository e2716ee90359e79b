/* The ATmega328P's side of the core: clock, light, UART, pins, watchdog, and the loop that keeps them going.
 * Pins are in board.h, the interrupts whose cycles are counted in vectors.S.
 *
 * The clock is timer 1: half microseconds, 16 bits, free running. The main loop carries it on into 32 bits of
 * microseconds at every turn, so a turn must not take 32 ms; sending never waits, and the longest (a shot's report
 * while light is gathered) takes some 10 ms. Timer 0 wakes the loop every millisecond; the watchdog resets the
 * board when it has not turned for 250 ms. The end of the trigger pulse is timed by timer 1 itself. */
#include "board.h"
#include "core.h"

#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/delay.h>

/* Room in the sending ring that events leave to an answer: that to hello is the longest but get's. */
enum { TX_RING = 256, ANSWER_ROOM = 112 };

/* Filled by the receive interrupt in vectors.S, emptied by the main loop. */
volatile uint8_t rx_ring[RX_RING];
volatile uint8_t rx_head, rx_tail;

static uint8_t tx_ring[TX_RING];
static uint8_t tx_head, tx_tail;

static struct core core;

/* ---- reset ---- */

static uint8_t reset_cause __attribute__((section(".noinit")));

/* Before anything else: boot loaders clear MCUSR, and the newer ones hand it over in r2. A watchdog that has just
 * bitten goes on running at 16 ms; here it gets its time. */
void early(void) __attribute__((naked, used, section(".init3")));
void early(void)
{
    uint8_t handed;
    __asm__ volatile("mov %0, r2" : "=r"(handed));
    const uint8_t cause = MCUSR & 0x0Fu;
    MCUSR = 0;
    reset_cause = cause != 0 ? cause : (handed & 0x0Fu);
    wdt_enable(WDTO_250MS);
}

/* ---- boot counter ---- */

/* Boot n is written to slot n mod 64, so that a cell wears 64 times slower than the board starts. A start that was
 * cut off while writing has not yet spoken, so its number may be given again. */
enum { BOOT_SLOTS = 64 };
static uint16_t boots[BOOT_SLOTS] EEMEM;

static uint16_t next_boot(void)
{
    uint16_t last = 0;
    bool any = false;
    for (uint8_t slot = 0; slot < BOOT_SLOTS; slot++) {
        const uint16_t boot = eeprom_read_word(&boots[slot]);
        const bool written = boot != 0xFFFFu && boot % BOOT_SLOTS == slot;
        if (written && (!any || (int16_t)(boot - last) > 0)) {
            last = boot;
            any = true;
        }
    }
    uint16_t next = (uint16_t)(last + 1u);
    if (next == 0xFFFFu) {
        next = 0; /* what an erased cell says */
    }
    eeprom_update_word(&boots[next % BOOT_SLOTS], next);
    return next;
}

/* ---- clock ---- */

/* A moment in microseconds and the same one in half microseconds of timer 1. The main loop writes the copy that is
 * not in use, so that an interrupt reads a whole one. */
struct stamp {
    uint32_t us;
    uint16_t ticks;
};
static volatile struct stamp stamps[2];
static volatile uint8_t stamp_now;

static uint32_t clock_us(void)
{
    cli();
    const uint16_t ticks = TCNT1; /* two bytes through one shared register */
    sei();
    const volatile struct stamp *last = &stamps[stamp_now];
    const uint16_t gone = (uint16_t)(ticks - last->ticks) & 0xFFFEu;
    const uint8_t other = stamp_now ^ 1u;
    const uint32_t now = last->us + gone / 2u;
    stamps[other].us = now;
    stamps[other].ticks = (uint16_t)(last->ticks + gone);
    stamp_now = other;
    return now;
}

/* In interrupts. */
static uint32_t clock_us_at(uint16_t ticks)
{
    const volatile struct stamp *last = &stamps[stamp_now];
    return last->us + (uint16_t)(ticks - last->ticks) / 2u;
}

/* ---- trigger and gate ---- */

static void time_pulse(uint16_t from_ticks)
{
    OCR1A = (uint16_t)(from_ticks + 2u * core.cfg.pulse_us);
    TIFR1 = _BV(OCF1A);
}

static void hal_trigger(void *ctx, bool high)
{
    (void)ctx;
    if (high) { /* the core holds interrupts off */
        time_pulse(TCNT1);
        PORTD |= _BV(TRIGGER);
    } else {
        PORTD &= (uint8_t)~_BV(TRIGGER);
    }
}

static void hal_gate(void *ctx, bool open)
{
    (void)ctx;
    if (open) {
        GPIOR0 |= _BV(GATE);
    } else {
        GPIOR0 &= (uint8_t)~_BV(GATE);
    }
}

static void hal_hold(void *ctx, bool on)
{
    (void)ctx;
    if (on) {
        cli();
    } else {
        sei();
    }
}

static bool hal_sync_closed(void *ctx)
{
    (void)ctx;
    return (PIND & _BV(SYNC)) == 0;
}

static bool hal_charged(void *ctx)
{
    (void)ctx;
    return (PIND & _BV(READY)) != 0;
}

/* ---- light ---- */

/* 1 MHz, 13 us a conversion. Never off once it runs: without ADEN the reference lets go of its capacitor. */
enum { ADC_ON = _BV(ADEN) | _BV(ADPS2) };

/* The reference is weak: from 5 V, which another program may have left there, it brings 100 nF into its own 32 kOhm
 * to 0.02 % of 1.1 V in 31 ms. Thrice that. */
enum { REFERENCE_SETTLES_MS = 100 };

/* The main loop's conversion is under way or done; an edge that takes the converter clears it. */
static volatile uint8_t converting;

/* Every 13 us from now on, with interrupts. A conversion of the main loop that is under way becomes the first sample:
 * there is one channel. In interrupts or while they are held off. */
static void gather_light(void)
{
    converting = 0;
    ADCSRA = ADC_ON | _BV(ADSC) | _BV(ADATE) | _BV(ADIE) | _BV(ADIF);
}

ISR(ADC_vect)
{
    core_light_sample(&core, ADC);
    if (core.sampling == 0) {
        ADCSRA = ADC_ON | _BV(ADIF);
    }
}

static void convert(void)
{
    cli();
    if (core.sampling == 0) {
        ADCSRA = ADC_ON | _BV(ADSC) | _BV(ADIF);
        converting = 1;
    }
    sei();
}

/* True once the conversion is done; *counts is CORE_ADC_NONE if an edge has taken the converter away. */
static bool converted(uint16_t *counts)
{
    bool done = true;
    *counts = CORE_ADC_NONE;
    cli();
    if (converting != 0) {
        done = (ADCSRA & _BV(ADSC)) == 0;
        if (done) {
            *counts = ADC;
            converting = 0;
        }
    }
    sei();
    return done;
}

static uint16_t hal_adc(void *ctx, uint8_t channel)
{
    (void)ctx, (void)channel;
    uint16_t counts = CORE_ADC_NONE;
    while (!converted(&counts)) {
    }
    convert();
    while (!converted(&counts)) {
    }
    return counts;
}

static void watch_dark(bool tick)
{
    uint16_t counts = CORE_ADC_NONE;
    if (converting != 0 && converted(&counts) && counts != CORE_ADC_NONE) {
        core_dark_sample(&core, counts);
    }
    if (tick && converting == 0) {
        convert();
    }
}

static void start_converter(void)
{
    DIDR0 = _BV(ADC0D);
    ADMUX = REFERENCE | LIGHT_CHANNEL;
    ADCSRA = ADC_ON;
    for (uint8_t ms = 0; ms < REFERENCE_SETTLES_MS; ms++) {
        _delay_ms(1);
        wdt_reset();
    }
    hal_adc(NULL, LIGHT_CHANNEL); /* the first after a change of reference may be wrong */
    hal_adc(NULL, LIGHT_CHANNEL);
}

/* ---- sync ---- */

/* What INT0_vect goes on to. The gate, if it was open, is closed already, and the trigger is up. */
void __vector_sync_edge(void) __attribute__((signal, used));
void __vector_sync_edge(void)
{
    const uint16_t ticks = TCNT1;
    const bool gated = (GPIOR0 & _BV(GATED)) != 0;
    if (gated) {
        time_pulse(ticks);
        GPIOR0 &= (uint8_t)~_BV(GATED);
    }
    const bool sampled = core.sampling != 0;
    core_sync_edge(&core, clock_us_at(ticks), gated);
    if (!sampled && core.sampling != 0) {
        gather_light();
    }
}

/* ---- UART ---- */

/* A line goes into the ring whole or not at all. A lost event shows as a gap in their numbers, and its shot can be
 * fetched; a lost answer is asked for again. */
static void hal_send(void *ctx, const char *line, uint8_t length, bool event)
{
    (void)ctx;
    const uint8_t free = (uint8_t)((uint8_t)(tx_tail - tx_head) - 1u);
    const uint16_t wanted = (uint16_t)length + (event ? ANSWER_ROOM : 0u);
    if (wanted > free) {
        return;
    }
    for (uint8_t i = 0; i < length; i++) {
        tx_ring[tx_head++] = (uint8_t)line[i];
    }
}

static void send_on(void)
{
    if (tx_head != tx_tail && (UCSR0A & _BV(UDRE0)) != 0) {
        UDR0 = tx_ring[tx_tail++];
    }
}

static void receive(void)
{
    while (rx_tail != rx_head) {
        const uint8_t byte = rx_ring[rx_tail];
        rx_tail = (uint8_t)(rx_tail + 1u) & (RX_RING - 1u);
        core_rx(&core, byte, clock_us());
        send_on();
    }
}

/* ---- start and loop ---- */

static LINE_ROM char mcu[] = "atmega328p";

static const struct core_hal hal = {
    .ctx = NULL,
    .send = hal_send,
    .trigger = hal_trigger,
    .gate = hal_gate,
    .hold = hal_hold,
    .adc = hal_adc,
    .sync_closed = hal_sync_closed,
    .charged = hal_charged,
    .mcu = mcu,
    .adc_channels = ADC_CHANNELS,
};

/* For a flash that nobody has described yet: 4 s of recycling suits most at full power. */
static const struct core_config defaults = {
    .sil_ms = 1500, .pulse_us = 1000, .lock_ms = 30, .win_us = 20000, .rec_ms = 4000, .rdy = 0
};

static void start(void)
{
    PORTD = _BV(SYNC); /* pull-up; the trigger low before it is an output */
    DDRD = _BV(TRIGGER);
    DDRB = _BV(ARMED);
    ACSR = _BV(ACD);
    GPIOR0 = 0;
    start_converter();

    TCCR1B = _BV(CS11); /* 2 MHz */
    TIMSK1 = _BV(OCIE1A);
    TCCR0A = _BV(WGM01);
    TCCR0B = _BV(CS01) | _BV(CS00); /* 250 kHz */
    OCR0A = 249;
    TIMSK0 = _BV(OCIE0A);

    UCSR0A = _BV(U2X0); /* before UBRR0, whose writing is when simavr works out the rate */
    UBRR0 = UBRR_115200;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);

    const uint16_t boot = next_boot();
    core_init(&core, &hal, &defaults, boot, reset_cause, clock_us());
    core_dark_sample(&core, hal_adc(NULL, LIGHT_CHANNEL));

    EICRA = _BV(ISC01); /* the contact closes: falling */
    EIFR = _BV(INTF0);
    EIMSK = _BV(INT0);
}

/* Until the next interrupt, unless there is something to do. */
static void rest(void)
{
    cli();
    if (rx_head == rx_tail && tx_head == tx_tail && (GPIOR0 & _BV(TICK)) == 0) {
        SMCR = _BV(SE); /* idle: all clocks but the processor's go on */
        sei();
        sleep_cpu();
        SMCR = 0;
    }
    sei();
}

int main(void)
{
    start();
    for (;;) {
        wdt_reset();
        const bool tick = (GPIOR0 & _BV(TICK)) != 0;
        GPIOR0 &= (uint8_t)~_BV(TICK);
        receive();
        core_poll(&core, clock_us());
        if (core.sampling != 0 && (ADCSRA & _BV(ADATE)) == 0) {
            cli(); /* a fire began a shot; an edge has its own way */
            gather_light();
            sei();
        }
        watch_dark(tick);
        send_on();
        if (core_gate_open(&core)) {
            PORTB |= _BV(ARMED);
        } else {
            PORTB &= (uint8_t)~_BV(ARMED);
        }
        rest();
    }
}
