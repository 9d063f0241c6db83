// The bus to the port expander of board V4 (MCP23017): its registers, and a log of the outputs that change.
#pragma once
#include "Arduino.h"

class TwoWire {
  public:
    void begin() {}
    void beginTransmission(uint8_t) { selecting = true; }
    void write(uint8_t value);
    uint8_t endTransmission() { return 0; }
    uint8_t requestFrom(int, int) { return 1; }
    uint8_t read() { return registers[selected]; }

  private:
    bool selecting = false;
    uint8_t selected = 0;
    uint8_t registers[0x16] = {0xFF, 0xFF};  // every pin an input
};
extern TwoWire Wire;
