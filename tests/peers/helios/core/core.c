/* Runs the firmware of a Helios laser DAC for a test: interrupts are calls, outputs are what the test reads here. */
#include "asf.h"
#include <setjmp.h>

int firmware_main(void);
void SysTick_Handler(void);
void TC0_Handler(void);
int callback_vendor_enable(void);
void callback_vendor_disable(void);

struct systick systick;
static jmp_buf asleep;
static uint8_t *bulk_buffer, *command_buffer;
static transferred bulk_done, command_done;
static uint8_t answer[64];
static int answer_length;
static uint32_t signature[128], timer_counts;

int x = 0x800, y = 0x800, shutter_pin, erased, timer_starts, configurations;
unsigned cycles; /* between two ticks; 0: none come */
uint8_t colours[4]; /* R, G, B, I */

void power_up(void) {
    memset(signature, 0xFF, sizeof signature);
    if (!setjmp(asleep)) firmware_main();
}

void sleepmgr_enter_sleep(void) { longjmp(asleep, 1); }

void plug(int in) {
    if (in) callback_vendor_enable();
    else callback_vendor_disable();
}

/* One transfer of the host's, whole; false where the device would not take it now. */
int bulk(const uint8_t *data, int length) {
    transferred done = bulk_done;
    if (!done) return 0;
    bulk_done = 0;
    memcpy(bulk_buffer, data, length);
    done(UDD_EP_TRANSFER_OK, length, 2);
    return 1;
}

int command(const uint8_t *data, int length, uint8_t *said) {
    transferred done = command_done;
    if (!done) return -1;
    command_done = 0;
    answer_length = 0;
    memcpy(command_buffer, data, length);
    done(UDD_EP_TRANSFER_OK, length, 6);
    memcpy(said, answer, answer_length);
    return answer_length;
}

int ticking(void) { return systick.CTRL != SysTick_CTRL_CLKSOURCE_Msk && cycles; }
void tick(void) { SysTick_Handler(); }
double timer_s(void) { return timer_counts / 32768.0; }
void timer(void) { TC0_Handler(); }

bool udi_vendor_bulk_out_run(uint8_t *buffer, iram_size_t size, transferred done) {
    if (bulk_done) return false; /* a transfer is under way already */
    bulk_buffer = buffer;
    bulk_done = done;
    return true;
}

bool udi_vendor_interrupt_out_run(uint8_t *buffer, iram_size_t size, transferred done) {
    command_buffer = buffer;
    command_done = done;
    return true;
}

bool udi_vendor_interrupt_in_run(uint8_t *data, iram_size_t size, transferred done) {
    memcpy(answer, data, answer_length = size);
    return true;
}

int SysTick_Config(uint32_t period) {
    cycles = period;
    systick.CTRL = 7;
    configurations++;
    return 0;
}

/* Two half words, each with its channel in bits 12 and 13. */
void dacc_write_conversion_data(int dacc, uint32_t data) {
    for (int half = 0; half < 2; half++, data >>= 16)
        *((data >> 12 & 3) ? &y : &x) = data & 0xFFF;
}

/* DAC084S085: channel in bits 14 and 15 (D is red), 01: write and update one, 10: all. */
void spi_write(int spi, uint16_t data, uint8_t a, uint8_t b) {
    if ((data >> 12 & 3) == 1) colours[3 - (data >> 14)] = data >> 4;
    if ((data >> 12 & 3) == 2) memset(colours, data >> 4, 4);
}

void ioport_set_pin_level(int pin, bool level) {
    if (pin == PIN_SHUTTER) shutter_pin = level;
}

void tc_find_mck_divisor(uint32_t hz, uint32_t clock, uint32_t *divisor, uint32_t *source, uint32_t board) {
    *divisor = clock / 32768; /* for 10 Hz: the slow clock */
    *source = 4;
}
void tc_write_rc(int timer, int channel, uint32_t counts) { timer_counts = counts; }
void tc_start(int timer, int channel) { timer_starts++; }

void flash_read_user_signature(uint32_t *data, uint32_t words) { memcpy(data, signature, 4 * words); }
void flash_write_user_signature(void *data, uint32_t words) { memcpy(signature, data, 4 * words); }
void flash_erase_user_signature(void) { memset(signature, 0xFF, sizeof signature); }
void flash_read_unique_id(uint32_t *data, uint32_t words) { for (uint32_t k = 0; k < words; k++) data[k] = 1050; }
void flash_clear_gpnvm(uint32_t bit) { erased = 1; longjmp(asleep, 1); }
