/* As much of a SAM4S microcontroller as the firmware of a Helios laser DAC asks for; core.c has what it does. */
#ifndef ASF_H
#define ASF_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LOW 0
#define HIGH 1
#define UNUSED(x) ((void)(x))

typedef int udd_ep_status_t;
typedef uint32_t iram_size_t;
typedef uint8_t udd_ep_id_t;
typedef void (*transferred)(udd_ep_status_t, iram_size_t, udd_ep_id_t);
#define UDD_EP_TRANSFER_OK 0
bool udi_vendor_bulk_out_run(uint8_t *, iram_size_t, transferred);
bool udi_vendor_interrupt_out_run(uint8_t *, iram_size_t, transferred);
bool udi_vendor_interrupt_in_run(uint8_t *, iram_size_t, transferred);

struct systick { uint32_t CTRL; };
extern struct systick systick;
#define SysTick (&systick)
#define SysTick_CTRL_CLKSOURCE_Msk 4u
int SysTick_Config(uint32_t cycles);

enum { DACC, DACC_ISR_TXRDY = 1 };
#define dacc_get_interrupt_status(d) DACC_ISR_TXRDY
void dacc_write_conversion_data(int, uint32_t);
enum { SPI };
void spi_write(int, uint16_t, uint8_t, uint8_t);
enum { PIN_SHUTTER = 20, PIN_STATUSLED = 22, PIN_POWERLED = 23, IOPORT_DIR_OUTPUT = 1 };
void ioport_set_pin_level(int, bool);
enum { TC0, WDT_MR_WDRSTEN = 1, WDT_MR_WDDBGHLT = 2, WDT_MR_WDIDLEHLT = 4 };
void tc_start(int, int);
void tc_write_rc(int, int, uint32_t);
void tc_find_mck_divisor(uint32_t, uint32_t, uint32_t *, uint32_t *, uint32_t);
#define tc_get_status(timer, channel) 0u
void flash_read_user_signature(uint32_t *, uint32_t);
void flash_write_user_signature(void *, uint32_t);
void flash_erase_user_signature(void);
void flash_read_unique_id(uint32_t *, uint32_t);
void flash_clear_gpnvm(uint32_t);
void sleepmgr_enter_sleep(void);
#define sysclk_get_cpu_hz() 112000000u  /* conf_clock.h: a 16 MHz crystal, times 7 */

#define cpu_irq_enter_critical()
#define cpu_irq_leave_critical()
#define wdt_restart(w)
#define wdt_get_timeout_value(a, b) 0u
#define wdt_init(a, b, c, d)
#define ioport_set_pin_dir(a, b)
#define gpio_configure_pin(a, b)
#define NVIC_SetPriority(a, b)
#define NVIC_DisableIRQ(a)
#define NVIC_ClearPendingIRQ(a)
#define NVIC_EnableIRQ(a)
#define tc_stop(a, b)
#define tc_init(a, b, c)
#define tc_enable_interrupt(a, b, c)
#define pmc_enable_periph_clk(a)
#define flash_init(a, b)
#define irq_initialize_vectors()
#define cpu_irq_enable()
#define sleepmgr_init()
#define sleepmgr_lock_mode(a)
#define sleepmgr_unlock_mode(a)
#define udc_start()
#define sysclk_init()
#define pmc_disable_all_periph_clk()
#define pmc_disable_pllbck()
#define sysclk_enable_peripheral_clock(a)
#define dacc_reset(a)
#define dacc_enable_channel(a, b)
#define dacc_set_transfer_mode(a, b)
#define dacc_enable_flexible_selection(a)
#define spi_enable_clock(a)
#define spi_disable(a)
#define spi_reset(a)
#define spi_set_master_mode(a)
#define spi_set_fixed_peripheral_select(a)
#define spi_disable_mode_fault_detect(a)
#define spi_configure_cs_behavior(a, b, c)
#define spi_set_delay_between_chip_select(a, b)
#define spi_set_peripheral_chip_select_value(a, b)
#define spi_set_clock_polarity(a, b, c)
#define spi_set_clock_phase(a, b, c)
#define spi_set_bits_per_transfer(a, b, c)
#define spi_set_baudrate_div(a, b, c)
#define spi_set_transfer_delay(a, b, c, d)
#define spi_enable(a)

/* Strings that make Windows choose a driver: compiled, never called. */
typedef struct { uint8_t bLength, bDescriptorType; } usb_str_desc_t;
typedef uint16_t le16_t;
#define UDC_DESC_STORAGE
#define USB_DT_STRING 3
#define cpu_to_le16(x) (x)
#define USB_REQ_TYPE_VENDOR 2
#define Udd_setup_type() 0
static struct {
    struct { uint8_t bRequest; uint16_t wValue, wIndex, wLength; } req;
    uint8_t *payload;
    uint16_t payload_size;
    void (*callback)(void);
    bool (*over_under_run)(void);
} udd_g_ctrlreq;

#endif
